"""What every robot and task promises of the parameters that it lets domain randomization change."""

from __future__ import annotations

import numpy as np
import pytest
from building import PAIRS, part, robot_task

from karolos.environments.robot_task import RobotTask

PAIR_CASES = [(robot, task) for robot, task in PAIRS]


def declared(environment: RobotTask) -> dict[str, tuple[float, float, float]]:
    parts = (("robot", environment.robot), ("task", environment.task))
    return {
        f"{what}.{name}": (parameter.nominal, parameter.low, parameter.high)
        for what, owner in parts
        for name, parameter in owner.parameters.items()
    }


def make(robot: str, task: str, values: dict[str, float]) -> RobotTask:
    drawn = tuple((name, part("distributions", "choice", values=(value,))) for name, value in sorted(values.items()))
    return robot_task(robot, task, randomization=drawn)


@pytest.mark.parametrize(("robot", "task"), PAIR_CASES)
def test_drawing_the_nominal_values_is_the_world_as_it_is(robot: str, task: str) -> None:
    plain = robot_task(robot, task)
    drawn = make(robot, task, {name: nominal for name, (nominal, _, _) in declared(plain).items()})
    for seed in range(2):
        starts = plain.reset(seed), drawn.reset(seed)
        for one, other in zip(*starts, strict=True):
            np.testing.assert_array_equal(one, other)
        actions = np.random.default_rng(seed).uniform(-1, 1, (8, plain.signature.action.size)).astype(np.float32)
        for action in actions:
            one, other = plain.step(action), drawn.step(action)
            np.testing.assert_array_equal(one.observation, other.observation)
            assert one.terminated == other.terminated
            if one.terminated:
                break
    plain.close()
    drawn.close()


@pytest.mark.parametrize(("robot", "task"), PAIR_CASES)
def test_extreme_values_of_every_parameter_can_be_drawn(robot: str, task: str) -> None:
    plain = robot_task(robot, task)
    for place in (1, 2):
        values = {name: bounds[place] for name, bounds in declared(plain).items()}
        environment = make(robot, task, values)
        environment.reset(0)
        np.testing.assert_allclose(environment.parameters(), [values[name] for name in sorted(values)], rtol=1e-6)
        environment.step(np.ones(environment.signature.action.size, np.float32))
        environment.close()
    plain.close()


def _trace(environment: RobotTask, seed: int) -> bytes:
    """What is observed in an episode's first steps of an arm that goes down, opens and closes and goes aside."""
    generator = np.random.default_rng(0)
    seen = [environment.reset(seed).observation]
    for step in range(30):
        action = generator.uniform(-1, 1, environment.signature.action.size).astype(np.float32)
        action[2] = -1.0 if step < 14 else action[2]
        after = environment.step(action)
        seen.append(after.observation)
        if after.terminated or after.truncated:
            break
    return b"".join(observation.tobytes() for observation in seen)


@pytest.mark.parametrize("robot", sorted({robot for robot, _ in PAIRS}))
def test_every_parameter_of_a_robot_changes_its_episodes_and_leaves_nothing_behind(robot: str) -> None:
    plain = robot_task(robot, "reach")
    nominal = _trace(plain, 3)
    for name, (usual, low, high) in declared(plain).items():
        if name == "task.floor_friction":  # nothing slides in reach
            continue
        other = high if high != usual else low
        changed = make(robot, "reach", {name: other})
        assert _trace(changed, 3) != nominal, name
        changed.close()
        assert _trace(plain, 3) == nominal, f"{name} reaches another world"
    plain.close()
