"""Hindsight: relabelled rewards and terminations, and the check of the first transitions."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.worlds import Counting, SameStep, counting_signature, feed, goals, make_buffer, places

from karolos.buffers.hindsight import Hindsight
from karolos.buffers.uniform import Uniform
from karolos.core import Signature
from karolos.errors import PluginError

ALWAYS = {"ratio": 1.0, "min_displacement": 0.0}


def filled(signature: Signature, steps: int, hindsight: dict[str, Any], *, fallen: bool = False) -> Any:
    """A full buffer of one environment, with episodes of the largest length."""
    buffer = make_buffer(Uniform, signature, steps, hindsight=hindsight)
    feed(buffer, Counting(1), steps, length=signature.max_steps, fallen=fallen)
    return buffer


@pytest.mark.parametrize("ends", [False, True])
def test_reward_and_termination_are_those_of_the_next_achieved_goal_under_the_new_goal(ends):
    batch = filled(counting_signature(6, rule=SameStep(ends=ends)), 12, ALWAYS).sample(500)
    arrived = [(episode, step + 1) == goal for (episode, step), goal in zip(places(batch), goals(batch), strict=True)]
    np.testing.assert_array_equal(batch.reward, np.float32(arrived))
    np.testing.assert_array_equal(batch.terminated, batch.reward * ends)
    assert 0 < batch.reward.mean() < 1


def test_a_termination_that_no_goal_explains_remains_under_any_goal():
    batch = filled(counting_signature(3), 6, ALWAYS, fallen=True).sample(200)
    np.testing.assert_array_equal(batch.terminated, [float(step == 2) for _, step in places(batch)])


def test_the_share_of_relabelled_transitions_is_the_ratio():
    buffer = filled(counting_signature(50), 50, {"ratio": 0.8, "min_displacement": 0.0})
    relabelled = (buffer.sample(20_000).desired_goal[:, 0] > 0).mean()
    assert relabelled == pytest.approx(0.8, abs=5 * (0.16 / 20_000) ** 0.5)


def test_the_original_goal_is_kept_where_nothing_moved():
    # One step moves the achieved goal by 1 here, k steps by k.
    batch = filled(counting_signature(10), 10, {"ratio": 1.0, "min_displacement": 2.5}).sample(2000)
    kept = batch.desired_goal[:, 0] == -7
    assert 0 < kept.mean() < 1
    assert (batch.reward[kept] == 0).all()
    moved = [goal[1] - step for (_, step), goal in zip(places(batch), goals(batch), strict=True) if goal[0] > 0]
    assert min(moved) == 3


def test_a_share_of_the_new_goals_is_achieved_by_the_transition_itself():
    batch = filled(counting_signature(50), 50, {**ALWAYS, "strategy": "final", "next_share": 0.25}).sample(20_000)
    before_the_end = np.array([step < 49 for _, step in places(batch)])
    assert batch.reward[before_the_end].mean() == pytest.approx(0.25, abs=5 * (0.1875 / 20_000) ** 0.5)


def test_a_share_of_the_other_transitions_gets_the_goal_of_another_one():
    buffer = make_buffer(Uniform, counting_signature(50), 50, hindsight={"ratio": 0.0, "others_share": 0.5})
    world = Counting(1)
    for step in range(50):
        given = world.step([0], over=[step == 49])
        goal = np.full_like(given.desired_goal, (1, 20) if step == 49 else -7 - step)  # as after step 19, or never
        buffer.add(given._replace(desired_goal=goal))
    batch = buffer.sample(20_000)
    steps = np.array([step for _, step in places(batch)])
    own = batch.desired_goal[:, 0] == np.where(steps == 49, 1, -7 - steps)
    assert own.mean() == pytest.approx(0.5 + 0.5 / 50, abs=5 * (0.25 / 20_000) ** 0.5)
    np.testing.assert_array_equal(
        batch.reward, np.float32([(1, step + 1) == goal for step, goal in zip(steps, goals(batch), strict=True)])
    )
    assert batch.reward.sum() > 0
    with pytest.raises(ValueError, match="set imitate: false"):
        Hindsight.Settings(others_share=0.5, imitate=True)


@pytest.mark.parametrize("n_step", [1, 3])
def test_what_a_reward_adds_to_the_rules_stays_under_any_goal(n_step):
    signature = replace(counting_signature(6), extra_reward=(-0.5, 0.0))
    buffers = [make_buffer(Uniform, signature, 12, hindsight=ALWAYS, n_step=n_step) for _ in range(2)]
    for buffer, extra in zip(buffers, (0.0, -0.25), strict=True):
        world = Counting(1)
        for step in range(12):
            given = world.step([0], over=[step % 6 == 5])
            buffer.add(given._replace(reward=given.reward + np.float32(extra)))
    plain, less = (buffer.sample(500) for buffer in buffers)
    steps = np.log(less.discount) / np.log(np.float32(0.9))
    expected = plain.reward - 0.25 * (1 - 0.9**steps) / (1 - 0.9)
    np.testing.assert_allclose(less.reward, expected, atol=1e-5)
    too_much = Counting(1).step([0], over=[False])._replace(reward=np.float32([-0.6]))
    with pytest.raises(PluginError, match=r"gave reward -0\.6"):
        buffers[0].add(too_much)


def test_relabelling_does_not_change_what_is_stored():
    buffer = filled(counting_signature(5), 10, {"ratio": 1.0})
    before = buffer.state()["storage"]["table"]
    buffer.sample(100)
    np.testing.assert_array_equal(buffer.state()["storage"]["table"], before)


def test_a_reward_that_is_not_the_goal_rules_is_refused_with_hindsight_only():
    wrong = Counting(1).step([0], over=[False])._replace(reward=np.float32([0.5]))
    buffer = make_buffer(Uniform, counting_signature(5), 10, hindsight={})
    with pytest.raises(PluginError, match=r"gave reward 0\.5, its goal rule says 0"):
        buffer.add(wrong)
    assert len(buffer) == 0
    plain = make_buffer(Uniform, counting_signature(5), 10)
    plain.add(wrong)
    assert (plain.sample(4).reward == 0.5).all()


def test_an_environment_that_ignores_its_goal_rules_termination_is_refused():
    buffer = make_buffer(Uniform, counting_signature(5, rule=SameStep(ends=True)), 10, hindsight={})
    transitions = Counting(1).step([0], over=[False])
    reached = transitions.next_achieved_goal[:, :2]
    with pytest.raises(PluginError, match="continued although its goal rule"):
        buffer.add(transitions._replace(desired_goal=reached, reward=np.ones(1, np.float32)))
