"""Relabelling: rewards, ends and the check at start-up."""

from __future__ import annotations

import numpy as np
import pytest
from support.worlds import Counting, SameStep, counting_signature
from test_uniform import goals, make, places

from karolos.errors import PluginError


def test_reward_is_that_of_the_next_achieved_goal() -> None:
    buffer = make(counting_signature(6), 12, hindsight={"ratio": 1.0, "min_displacement": 0.0})
    world = Counting(1)
    for step in range(12):
        buffer.add(world.step([0], over=[step % 6 == 5]))
    batch = buffer.sample(500)
    arrived = [(episode, step + 1) == goal for (episode, step), goal in zip(places(batch), goals(batch), strict=True)]
    np.testing.assert_array_equal(batch.reward, np.float32(arrived))
    assert 0 < batch.reward.mean() < 1


def test_termination_is_asked_again_under_the_new_goal() -> None:
    buffer = make(
        counting_signature(6, rule=SameStep(ends=True)), 12, hindsight={"ratio": 1.0, "min_displacement": 0.0}
    )
    world = Counting(1)
    for step in range(12):
        buffer.add(world.step([0], over=[step % 6 == 5]))
    batch = buffer.sample(500)
    np.testing.assert_array_equal(batch.terminated, batch.reward)
    assert 0 < batch.terminated.mean() < 1


def test_an_end_that_no_goal_explains_stays_one_under_any_goal() -> None:
    buffer = make(counting_signature(3), 6, hindsight={"ratio": 1.0, "min_displacement": 0.0})
    world = Counting(1)
    for step in range(6):
        buffer.add(world.step([0], over=[step % 3 == 2], fallen=True))
    batch = buffer.sample(200)
    np.testing.assert_array_equal(batch.terminated, [float(step == 2) for _, step in places(batch)])


def test_the_share_of_relabelled_transitions_is_the_ratio() -> None:
    buffer = make(counting_signature(50), 50, hindsight={"ratio": 0.8, "min_displacement": 0.0})
    world = Counting(1)
    for step in range(50):
        buffer.add(world.step([0], over=[step == 49]))
    relabelled = (buffer.sample(20_000).desired_goal[:, 0] > 0).mean()
    assert relabelled == pytest.approx(0.8, abs=5 * (0.16 / 20_000) ** 0.5)


def test_the_original_goal_is_kept_where_nothing_moved() -> None:
    # One step moves the achieved goal by 1 here, k steps by k.
    buffer = make(counting_signature(10), 10, hindsight={"ratio": 1.0, "min_displacement": 2.5})
    world = Counting(1)
    for step in range(10):
        buffer.add(world.step([0], over=[step == 9]))
    batch = buffer.sample(2000)
    kept = batch.desired_goal[:, 0] == -7
    assert 0 < kept.mean() < 1
    assert (batch.reward[kept] == 0).all()
    moved = [goal[1] - step for (_, step), goal in zip(places(batch), goals(batch), strict=True) if goal[0] > 0]
    assert min(moved) == 3


def test_relabelling_does_not_change_what_is_stored() -> None:
    buffer = make(counting_signature(5), 10, hindsight={"ratio": 1.0})
    world = Counting(1)
    for _ in range(5):
        buffer.add(world.step([0], over=[False]))
    before = buffer.state()["storage"]["table"]
    buffer.sample(100)
    np.testing.assert_array_equal(buffer.state()["storage"]["table"], before)


def test_reward_that_is_not_the_goal_rules_is_refused_at_start_up() -> None:
    buffer = make(counting_signature(5), 10, hindsight={})
    transitions = Counting(1).step([0], over=[False])
    with pytest.raises(PluginError, match=r"gave reward 0\.5, its goal rule says 0"):
        buffer.add(transitions._replace(reward=np.float32([0.5])))
    assert len(buffer) == 0


def test_an_environment_that_ignores_its_goal_rules_termination_is_refused_at_start_up() -> None:
    buffer = make(counting_signature(5, rule=SameStep(ends=True)), 10, hindsight={})
    transitions = Counting(1).step([0], over=[False])
    reached = transitions.next_achieved_goal[:, :2]
    with pytest.raises(PluginError, match="continued although its goal rule"):
        buffer.add(transitions._replace(desired_goal=reached, reward=np.ones(1, np.float32)))


def test_without_hindsight_any_reward_goes() -> None:
    buffer = make(counting_signature(5), 10)
    transitions = Counting(1).step([0], over=[False])
    buffer.add(transitions._replace(reward=np.float32([0.5])))
    assert (buffer.sample(4).reward == 0.5).all()
