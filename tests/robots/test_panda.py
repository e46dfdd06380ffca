"""An arm with its gripper: grasping, yaw, delay, noise."""

from __future__ import annotations

import numpy as np
import pytest
from support.closing import opened

from karolos.environments.robot_task import RobotTask
from karolos.errors import PluginError
from karolos.robots.panda import Panda
from karolos.tasks.reach import Reach


class Grasping(Reach):
    """Reach with a gripper that opens and closes."""

    uses_gripper = True


def environment(task: type[Reach] = Reach, **settings: object) -> RobotTask:
    robot = Panda(Panda.Settings(**settings))
    return opened(RobotTask(RobotTask.Settings(), robot=robot, task=task(task.Settings(max_steps=1000))))


@pytest.mark.parametrize("control", ["joint", "cartesian"])
def test_gripper_opens_and_closes_and_its_fingers_agree(control: str) -> None:
    made = environment(Grasping, control=control)
    made.reset(0)
    where = made.signature.observation.slice("gripper_opening")
    action = np.zeros(made.signature.action.size)
    for wish, opening in ((-1.0, 0.0), (1.0, 1.0), (0.0, 0.5)):
        action[-1] = wish
        for _ in range(30):
            step = made.step(action)
        assert step.observation[where] == pytest.approx(opening, abs=0.03)
        first, second = made.robot.body.joints([7, 8])  # type: ignore[attr-defined]
        assert abs(first[0] - second[0]) < 1e-3


def test_yaw_turns_the_gripper_and_is_seen() -> None:
    made = environment(yaw=True)
    start = made.reset(0)
    heading = made.signature.observation.slice("tool_heading")
    for _ in range(10):
        step = made.step(np.array([0.0, 0.0, 0.0, 0.5]))
    before, after = (np.arctan2(*s.observation[heading][::-1]) for s in (start, step))
    assert after - before > 0.4
    assert np.linalg.norm(step.achieved_goal - start.achieved_goal) < 0.01


def test_tool_that_cannot_be_placed_is_a_clear_error() -> None:
    made = environment()
    made.reset(0)
    with pytest.raises(PluginError, match="workspace"):
        made.robot.place_tool((1.5, 0.0, 0.2), 0.0)


def test_delayed_action_takes_effect_later() -> None:
    made = environment()
    started = made.reset(0).observation[:3]
    made.robot.apply("action_delay", 2.0)
    made.reset(0)
    push = np.array([1.0, 0.0, 0.0])
    moved = [float(np.linalg.norm(made.step(push).observation[:3] - started)) for _ in range(5)]
    assert max(moved[:2]) < 0.002
    assert moved[4] > 0.01


def test_noise_is_on_the_observation_and_not_on_the_goal() -> None:
    made = environment()
    made.reset(0)
    made.robot.apply("observation_noise", 0.05)
    step = made.reset(0)
    assert np.abs(step.observation[:3] - step.achieved_goal).max() > 0.001
    again = made.reset(0)
    np.testing.assert_array_equal(step.observation, again.observation)
