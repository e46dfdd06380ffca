"""An environment of gymnasium's as one of karolos's."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from karolos.core import Discrete
from karolos.environments.gymnasium import Gymnasium
from karolos.errors import KarolosError


def make(**settings: Any) -> Gymnasium:
    return Gymnasium(Gymnasium.Settings(**settings))


def play(environment: Gymnasium, seed: int, action: list[float]) -> list[Any]:
    steps = [environment.reset(seed)]
    while not (steps[-1].terminated or steps[-1].truncated):
        steps.append(environment.step(np.array(action, np.float32)))
    return steps


def test_discrete_actions_become_labels_and_the_pole_falls() -> None:
    environment = make(id="CartPole-v1")
    assert environment.signature.action == Discrete(("0", "1"))
    steps = play(environment, 1, [1])
    assert steps[-1].terminated
    assert not steps[-1].truncated
    assert steps[0].observation.shape == (4,)
    with pytest.raises(RuntimeError, match="over"):
        environment.step(np.zeros(1))
    with pytest.raises(ValueError, match="from 0 to 1"):
        environment.step(np.array([2.0]))


def test_box_actions_are_rescaled() -> None:
    environment = make(id="Pendulum-v1")
    assert environment._converted(np.array([1.0]))[0] == 2.0
    assert environment._converted(np.array([-0.5]))[0] == -1.0
    with pytest.raises(ValueError, match="finite"):
        environment.step(np.array([np.nan]))


def test_same_seed_gives_same_episode_in_a_fresh_and_in_a_used_environment() -> None:
    used, fresh = make(id="Pendulum-v1"), make(id="Pendulum-v1")
    play(used, 5, [0.3])
    for one, other in zip(play(used, 7, [0.1]), play(fresh, 7, [0.1]), strict=True):
        np.testing.assert_array_equal(one.observation, other.observation)
        assert one.reward == other.reward


def test_own_limit_of_steps_truncates() -> None:
    steps = play(make(id="Pendulum-v1", max_steps=7), 0, [0.0])
    assert len(steps) == 8
    assert steps[-1].truncated


@pytest.mark.parametrize(("threshold", "success"), [(5.0, True), (500.0, False)])
def test_success_is_a_return_at_the_end(threshold: float, success: bool) -> None:
    steps = play(make(id="CartPole-v1", success_return=threshold), 1, [1])
    assert bool(steps[-1].success) is success
    assert not any(step.success for step in steps[:-1])


@pytest.mark.parametrize(
    ("settings", "where"),
    [
        ({"id": "CartPol-v1"}, "environment.id"),
        ({"id": "nowhere:Foo-v1"}, "environment.id"),
        ({"id": "a b"}, "environment.id"),
        ({"id": "CartPole-v1", "kwargs": {"foo": 1}}, "environment.kwargs"),
        ({"id": "karolos.environments.gymnasium_export:karolos/PandaReach-v1"}, "environment.id"),
        (
            {"id": "karolos.environments.gymnasium_export:karolos/PandaReach-v1", "flatten_goals": True},
            "environment.max_steps",
        ),
    ],
)
def test_what_cannot_work_is_one_clear_line_about_a_setting(settings: dict[str, Any], where: str) -> None:
    with pytest.raises(KarolosError) as caught:
        make(**settings)
    assert caught.value.where == where
    assert "\n" not in str(caught.value)


def test_goals_may_be_taken_as_observations() -> None:
    name = "karolos.environments.gymnasium_export:karolos/PandaReach-v1"
    environment = make(id=name, flatten_goals=True, max_steps=50)
    assert set(environment.signature.observation.names) == {"achieved_goal", "desired_goal", "observation"}
    assert environment.reset(0).observation.shape == (environment.signature.observation.size,)
    environment.close()
