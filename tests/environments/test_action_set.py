"""The discrete action set of robots: its labels, what they do, and what stays as it was asked for."""

import gymnasium
import numpy as np
import pytest
from support.rig import made

from karolos.core import Discrete, Field, Layout
from karolos.environments.action_set import ActionSet, action_index
from karolos.environments.robot_task import RobotTask
from karolos.errors import UsageError

CARTESIAN = Layout((Field("tool_position_change", 3), Field("gripper_opening", 1)))
X_UP, Y_DOWN, OPEN, CLOSE, NOTHING = 0, 3, 6, 7, 8


def discrete(task: str = "reach") -> RobotTask:
    return made(task, environment={"actions": "discrete"})


def test_labels_name_a_step_along_each_axis_in_both_directions_and_nothing():
    labels = ActionSet(CARTESIAN).actions.labels
    axes = ("tool_position_change x", "tool_position_change y", "tool_position_change z", "gripper_opening")
    assert labels == (*(f"{axis} {sign}" for axis in axes for sign in "+-"), "nothing")
    joints = ActionSet(Layout((Field("joint_changes", 7),))).actions.labels
    assert len(joints) == 15
    assert joints[:3] == ("joint_changes 1 +", "joint_changes 1 -", "joint_changes 2 +")


def test_every_action_but_those_of_the_gripper_moves_one_axis_by_one_full_step():
    actions = ActionSet(Layout((Field("tool_position_change", 3), Field("yaw_change", 1))))
    found = np.array([actions.values(index) for index in range(len(actions.actions.labels))])
    steps = np.kron(np.eye(4), [[1], [-1]])
    np.testing.assert_array_equal(found, np.vstack([steps, np.zeros(4)]))


def test_the_opening_stays_as_it_was_asked_for_last():
    actions = ActionSet(CARTESIAN)
    actions.reset(1.0)
    asked = [actions.values(index)[3] for index in (NOTHING, X_UP, CLOSE, NOTHING, Y_DOWN, OPEN, X_UP)]
    assert asked == [1, 1, -1, -1, -1, 1, 1]
    actions.reset(0.25)
    assert actions.values(NOTHING) == [0, 0, 0, -0.5]


def test_the_gripper_of_a_robot_closes_stays_closed_and_opens_at_the_next_reset():
    picking = discrete("pick_place")

    def away(seed: int) -> float:
        return float(np.linalg.norm(picking.reset(seed).achieved_goal - picking.robot.tool_position))

    seed = next(seed for seed in range(20) if away(seed) > 0.1)  # the cube is not between the fingers
    for action in (CLOSE, *[NOTHING] * 30):
        picking.step(np.array(action))
    closed = picking.robot.opening
    for _ in range(5):
        picking.step(np.array(X_UP))
    assert closed < 0.1
    assert picking.robot.opening < 0.1
    picking.reset(seed)
    for _ in range(5):
        picking.step(np.array(NOTHING))
    assert picking.robot.opening > 0.9


def test_a_discrete_action_is_the_continuous_one_that_it_stands_for_in_any_form_it_travels_in():
    actions = Discrete(("a", "b", "c"))
    assert [action_index(form, actions, "x") for form in (2, np.int64(2), np.array(2), np.float32([2]))] == [2] * 4
    one, other = discrete(), made("reach")
    one.reset(3)
    other.reset(3)
    for index, values in ((0, [1, 0, 0]), (5, [0, 0, -1]), (6, [0, 0, 0])):
        ours, theirs = one.step(np.float32([index])), other.step(np.float32(values))
        np.testing.assert_array_equal(ours.observation, theirs.observation)


def test_gymnasium_has_the_set_as_a_discrete_space_and_experts_are_refused():
    environment = gymnasium.make("karolos.gym:karolos/PandaPickPlace-v2", actions="discrete")
    assert environment.action_space == gymnasium.spaces.Discrete(9)
    told = r"environment\.actions.*discrete ones.*environment\.actions=continuous"
    with pytest.raises(UsageError, match=told):
        discrete().expert()


@pytest.mark.parametrize("action", [-1, 7, 0.5, np.nan, [0, 1], [0.0, 0.0, 0.0]])
def test_an_action_that_is_none_of_the_set_is_refused_and_the_episode_goes_on(action):
    environment = discrete()
    environment.reset(0)
    with pytest.raises(ValueError, match="PandaReach: an action is a number from 0 to 6"):
        environment.step(np.array(action))
    assert np.isfinite(environment.step(np.array(6)).observation).all()
