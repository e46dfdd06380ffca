"""What every environment promises: each robot with each task, and those that need neither."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from building import CONTROLS, PAIRS, goes_with, part, robot_task

from karolos.core import Array, Environment, Step
from karolos.environments.build import build_environment
from karolos.registry import load, names
from karolos.spec.recipe import Recipe
from karolos.training import random_actions

PLAIN = [
    name
    for name in names("environments")
    if name != "robot_task"
    and not any(field.is_required() for field in load("environments", name).Settings.model_fields.values())
]
CASES = [
    *((robot, task, control) for robot, task in PAIRS for control in CONTROLS if goes_with(task, control)),
    *((name,) for name in PLAIN),
]


def make(case: tuple[str, ...]) -> Environment:
    if len(case) == 1:
        return build_environment(Recipe(environment=part("environments", case[0])))
    return robot_task(case[0], case[1], control=case[2])


@pytest.fixture(scope="module", params=CASES, ids="-".join)
def case(request: pytest.FixtureRequest) -> tuple[str, ...]:
    return tuple(request.param)


@pytest.fixture(scope="module")
def environment(case: tuple[str, ...]) -> Iterator[Environment]:
    made = make(case)
    yield made
    made.close()


def actions(environment: Environment, seed: int, count: int | None = None) -> Array:
    generator = np.random.default_rng(seed)
    return random_actions(environment.signature, count or environment.signature.max_steps, generator)


def play(environment: Environment, seed: int) -> list[Step]:
    """An episode of random actions, with its reset."""
    steps = [environment.reset(seed)]
    for action in actions(environment, seed):
        steps.append(environment.step(action))
        if steps[-1].terminated or steps[-1].truncated:
            break
    return steps


def assert_same(first: list[Step], second: list[Step]) -> None:
    assert len(first) == len(second)
    for one, other in zip(first, second, strict=True):
        for left, right in zip(one, other, strict=True):
            np.testing.assert_array_equal(left, right)


def test_same_seed_gives_same_trajectory_in_a_fresh_and_in_a_used_environment(
    environment: Environment, case: tuple[str, ...]
) -> None:
    first = play(environment, 3)
    play(environment, 4)
    environment.reset(5)  # an episode that is left unfinished
    environment.step(actions(environment, 0, 1)[0])
    fresh = make(case)
    assert_same(first, play(environment, 3))
    assert_same(first, play(fresh, 3))
    fresh.close()


def test_different_seeds_give_different_episodes(environment: Environment) -> None:
    starts = [environment.reset(seed) for seed in range(4)]
    assert len({(step.observation.tobytes(), step.desired_goal.tobytes()) for step in starts}) == 4


def test_steps_are_as_the_signature_says(environment: Environment) -> None:
    signature = environment.signature
    steps = play(environment, 7)
    for step in steps:
        assert step.observation.shape == (signature.observation.size,)
        assert step.achieved_goal.shape == (signature.achieved_goal.size,)
        assert step.desired_goal.shape == (signature.desired_goal.size,)
        assert all(part.dtype == np.float32 for part in step[:3])
        assert signature.reward_range[0] <= step.reward <= signature.reward_range[1]
    assert steps[0].reward == 0
    assert not steps[0].terminated
    assert not steps[0].truncated
    assert len(steps) - 1 <= signature.max_steps
    assert environment.parameters().shape == (signature.parameters.size,)


def test_episode_ends_once_and_no_step_follows(environment: Environment) -> None:
    steps = play(environment, 8)
    ends = [step.terminated or step.truncated for step in steps]
    assert ends.index(True) == len(steps) - 1
    assert not (steps[-1].terminated and steps[-1].truncated)
    with pytest.raises(RuntimeError, match="over"):
        environment.step(actions(environment, 0, 1)[0])


def test_arrays_of_a_step_are_not_written_again(environment: Environment) -> None:
    step = environment.reset(1)
    kept = [np.copy(value) for value in step]
    environment.step(actions(environment, 1, 1)[0])
    environment.reset(2)
    for before, after in zip(kept, step, strict=True):
        np.testing.assert_array_equal(before, after)


def test_goal_rule_gives_the_rewards_and_ends_of_the_steps(environment: Environment) -> None:
    rule = environment.signature.goal_rule
    if rule is None:
        pytest.skip("no goals")
    steps = play(environment, 9)[1:]
    achieved, desired = (np.stack([step[column] for step in steps]) for column in (1, 2))
    np.testing.assert_array_equal(rule.reward(achieved, desired), np.array([s.reward for s in steps], np.float32))
    np.testing.assert_array_equal(rule.success(achieved, desired), [step.success for step in steps])
    np.testing.assert_array_equal(rule.terminated(achieved, desired), [step.terminated for step in steps])


def test_goal_is_never_reached_at_the_start(environment: Environment) -> None:
    assert not any(environment.reset(seed).success for seed in range(300))


def test_closing_twice_is_safe(case: tuple[str, ...]) -> None:
    made = make(case)
    made.reset(0)
    made.close()
    made.close()
