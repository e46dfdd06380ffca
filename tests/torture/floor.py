"""How deep policies that press, squeeze and strike bring the cube into the floor, and how fast it leaves the tool.

    python tests/torture/floor.py --episodes 100 --engine bullet

plays each policy with each pair of a robot and a task. A cube may be 5 mm deep, and while it falls also the distance
that it falls in one physics step: contacts are found at the end of a step. It exits with 1 when a cube was deeper or
the physics diverged. The excess is what the cube's speed, its fall left out, has over 1.1 times the largest speed that
tool and pads had in the last four control steps, looked at in every physics step. It is measured until one control step
after the arm touched the cube. Printed are the largest excess and the share of episodes with more than .1 m/s.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import Any, NamedTuple, get_args

import numpy as np

from karolos.core import Array
from karolos.environments.robot_task import TIMESTEP, RobotTask
from karolos.registry import load, names
from karolos.simulation.engines import Engine

DEEPEST = 0.005
Policy = Callable[[RobotTask, int, np.random.Generator], Array]


class Trial(NamedTuple):
    """Of one pair and policy."""

    depth: float
    """Largest, m."""
    excess: list[float]
    """Largest of each episode, m/s."""
    divergences: int


def press(environment: RobotTask, step: int, _: np.random.Generator) -> Array:
    """Over the cube, then down with the closed gripper."""
    x, y, _ = cube_of(environment).position
    return environment.robot.towards((x, y, 0.0 if step > 14 else 0.12), 0.0)


def sweep(environment: RobotTask, _: int, draws: np.random.Generator) -> Array:
    """Low over the floor, at random around the cube."""
    x, y, _ = cube_of(environment).position
    dx, dy = draws.normal(0, 0.05, 2)
    action = environment.robot.towards((x + dx, y + dy, 0.0), 0.0)
    return np.clip(action + 0.5 * draws.uniform(-1, 1, action.size), -1, 1)


def squeeze(environment: RobotTask, step: int, draws: np.random.Generator) -> Array:
    """Grip the cube, then full random actions with the gripper closed."""
    x, y, z = cube_of(environment).position
    action = environment.robot.towards((x, y, z if step > 8 else 0.15), 1.0 if step < 22 else 0.0)
    if step > 28:
        gripper = action[-1]
        action = draws.choice([-1.0, 1.0], action.size)
        action[-1] = gripper
    return action


def bang_bang(environment: RobotTask, _: int, draws: np.random.Generator) -> Array:
    """Full actions in random directions."""
    return draws.choice([-1.0, 1.0], environment.signature.action.size)


def random(environment: RobotTask, _: int, draws: np.random.Generator) -> Array:
    """Uniform actions."""
    return draws.uniform(-1, 1, environment.signature.action.size)


POLICIES: dict[str, Policy] = {
    "press": press,
    "sweep": sweep,
    "squeeze": squeeze,
    "bang-bang": bang_bang,
    "random": random,
}


def cube_of(environment: RobotTask) -> Any:
    return environment.task.cube  # type: ignore[attr-defined]


class ToolSpeed:
    """The largest speed of tool and pads in the physics steps since it was last asked for."""

    def __init__(self, robot: Any) -> None:
        self._robot = robot
        self._largest = 0.0
        self._set_targets = robot._motors.substep
        robot._motors.substep = self._substep

    def _substep(self, step: int, *of_engine: Any) -> None:
        self._set_targets(step, *of_engine)
        robot = self._robot
        positions, velocities, *_ = zip(*robot.body.joints(range(robot.chain.size)), strict=True)
        speeds = [robot.chain.velocity(robot.forward(positions), velocities)]
        speeds += [robot.body.link(pad).velocity for pad in robot._motors.pads]
        self._largest = max(self._largest, *np.linalg.norm(speeds, axis=1).tolist())

    def take(self) -> float:
        largest, self._largest = self._largest, 0.0
        return largest


def touched(environment: RobotTask) -> bool:
    robot: Any = environment.robot
    cube = cube_of(environment).body
    return any(environment.world.contacts(robot.body, cube, link) for link in robot.body.links().values())


def trial(environment: RobotTask, policy: Policy, episodes: int) -> Trial:
    """Play the policy; the first episodes have the seeds 0, 1, ..."""
    depth, excesses = 0.0, []
    before = environment.divergences
    tool: ToolSpeed | None = None
    for seed in range(episodes):
        draws = np.random.default_rng(seed)
        step = environment.reset(seed)
        if tool is None:
            tool = ToolSpeed(environment.robot)
        speeds, recent, excess, count = [0.0] * 4, [False] * 2, 0.0, 0
        while not (step.terminated or step.truncated):
            falling = max(0.0, -cube_of(environment).velocity[2]) if hasattr(environment.task, "cube") else 0.0
            step = environment.step(policy(environment, count, draws))
            count += 1
            if step.diverged:  # the next reset builds a new world
                tool = None
            if not hasattr(environment.task, "cube") or tool is None:
                continue
            cube = cube_of(environment)
            depth = max(depth, -cube.lowest - (falling + 9.81 * environment.robot.period) * TIMESTEP * (falling > 0.2))
            speeds = [*speeds[1:], tool.take()]
            recent = [recent[1], touched(environment)]
            if any(recent):
                x, y, z = cube.velocity
                excess = max(excess, float(np.linalg.norm((x, y, max(z, 0.0)))) - 1.1 * max(speeds))
        excesses.append(excess)
    return Trial(depth, excesses, environment.divergences - before)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--robots", nargs="*", default=names("robots"))
    parser.add_argument("--engine", choices=get_args(Engine), default="bullet")
    arguments = parser.parse_args()
    failed = False
    for robot in arguments.robots:
        for task in names("tasks"):
            robot_class, task_class = load("robots", robot), load("tasks", task)
            environment = RobotTask(
                RobotTask.Settings(engine=arguments.engine),
                robot=robot_class(robot_class.Settings()),
                task=task_class(task_class.Settings()),
            )
            for name, policy in POLICIES.items():
                if task == "reach" and name in {"press", "sweep", "squeeze"}:
                    continue  # it has no cube
                if name == "squeeze" and not task_class.uses_gripper:
                    continue
                found = trial(environment, policy, arguments.episodes)
                bad = found.depth > DEEPEST or found.divergences > 0
                failed |= bad
                excess = np.array(found.excess)
                print(
                    f"{robot:6} {task:10} {name:10} depth {1000 * found.depth:4.1f} mm, excess {excess.max():.2f} m/s, "
                    f"above .1 {(excess > 0.1).mean():.2f}, diverged {found.divergences}{'  FAILED' if bad else ''}",
                    flush=True,
                )
            environment.close()
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
