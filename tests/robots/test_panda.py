"""An arm with its gripper: grasping, yaw, delay, noise."""

import numpy as np
import pytest
from support.rig import made

from karolos.errors import PluginError


@pytest.mark.parametrize("control", ["joint", "cartesian"])
def test_gripper_opens_and_closes_and_its_fingers_agree(control):
    environment = made("pick_place", arm={"control": control}, max_steps=1000)
    environment.reset(0)
    where = environment.signature.observation.slice("gripper_opening")
    action = np.zeros(environment.signature.action.size)
    for wish, opening in ((-1.0, 0.0), (1.0, 1.0), (0.0, 0.5)):
        action[-1] = wish
        for _ in range(30):
            step = environment.step(action)
        assert step.observation[where] == pytest.approx(opening, abs=0.03)
        first, second = environment.robot.body.joints([7, 8])  # type: ignore[attr-defined]
        assert abs(first[0] - second[0]) < 1e-3


def test_yaw_turns_the_gripper_and_is_seen():
    environment = made("reach", arm={"yaw": True})
    start = environment.reset(0)
    heading = environment.signature.observation.slice("tool_heading")
    for _ in range(10):
        step = environment.step(np.array([0.0, 0.0, 0.0, 0.5]))
    before, after = (np.arctan2(*s.observation[heading][::-1]) for s in (start, step))
    assert after - before > 0.4
    assert np.linalg.norm(step.achieved_goal - start.achieved_goal) < 0.01


def test_tool_that_cannot_be_placed_is_a_clear_error():
    environment = made("reach")
    environment.reset(0)
    with pytest.raises(PluginError, match="workspace"):
        environment.robot.place_tool((1.5, 0.0, 0.2), 0.0)


def test_delayed_action_takes_effect_later():
    environment = made("reach")
    started = environment.reset(0).observation[:3]
    environment.robot.apply("action_delay", 2.0)
    environment.reset(0)
    push = np.array([1.0, 0.0, 0.0])
    moved = [float(np.linalg.norm(environment.step(push).observation[:3] - started)) for _ in range(5)]
    assert max(moved[:2]) < 0.002
    assert moved[4] > 0.01


def test_noise_is_on_the_observation_and_not_on_the_goal():
    environment = made("reach")
    environment.reset(0)
    environment.robot.apply("observation_noise", 0.05)
    step = environment.reset(0)
    assert np.abs(step.observation[:3] - step.achieved_goal).max() > 0.001
    again = environment.reset(0)
    np.testing.assert_array_equal(step.observation, again.observation)
