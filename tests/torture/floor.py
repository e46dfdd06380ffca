"""How deep policies that press, squeeze and strike bring the cube into the floor.

    python tests/torture/floor.py --episodes 100 --engine mujoco

plays each policy with each pair of a robot and a task. A cube may be 5 mm deep, and while it falls also the distance
that it falls in one physics step: contacts are found at the end of a step. It exits with 1 when a cube was deeper or
the physics diverged.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import Any, NamedTuple, get_args

import numpy as np

from karolos.core import Array
from karolos.environments.robot_task import RobotTask
from karolos.registry import load, names
from karolos.simulation.engines import Engine

DEEPEST = 0.005
Policy = Callable[[RobotTask, int, np.random.Generator], Array]


class Trial(NamedTuple):
    """Of one pair and policy."""

    depth: float
    """Largest, m."""
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


def trial(environment: RobotTask, policy: Policy, episodes: int) -> Trial:
    """Play the policy; the first episodes have the seeds 0, 1, ..."""
    depth, before = 0.0, environment.divergences
    for seed in range(episodes):
        draws, count = np.random.default_rng(seed), 0
        step = environment.reset(seed)
        while not (step.terminated or step.truncated):
            has_cube = hasattr(environment.task, "cube")
            falling = max(0.0, -cube_of(environment).velocity[2]) if has_cube else 0.0
            step = environment.step(policy(environment, count, draws))
            count += 1
            if has_cube and not step.diverged:
                fall = (falling + 9.81 * environment.robot.period) / 240 * (falling > 0.2)
                depth = max(depth, -cube_of(environment).lowest - fall)
    return Trial(depth, environment.divergences - before)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--robots", nargs="*", default=names("robots"))
    parser.add_argument("--engine", choices=get_args(Engine), default="mujoco")
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
                print(
                    f"{robot:6} {task:10} {name:10} depth {1000 * found.depth:4.1f} mm, "
                    f"diverged {found.divergences}{'  FAILED' if bad else ''}",
                    flush=True,
                )
            environment.close()
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
