"""The dense reward of pick and place: more for every stage, bounded, a function of what the goal rule sees."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.rig import ROBOTS, made

from karolos.core import Array
from karolos.tasks.pick_place import StagedPick

RULE = StagedPick(0.05, rest=0.02)
GOAL = np.array([0.5, 0.1, 0.2], np.float32)
places = st.tuples(*[st.floats(-0.5, 0.5)] * 3)
shares = st.floats(0, 1)


def worth(cube: Array, tool: Array, pads: float, goal: Array = GOAL) -> float:
    return float(RULE.reward(np.array([*cube, *tool, pads], np.float32), np.asarray(goal, np.float32)))


def away_from_the_goal(cube: Array, goal: Array = GOAL) -> bool:
    return bool(np.linalg.norm(np.subtract(cube, goal)) > 0.051)


@given(places, shares, shares, st.sampled_from([0.0, 0.5, 1.0]))
def test_the_nearer_the_tool_to_the_cube_the_higher_a_held_cube_and_the_nearer_it_to_the_goal_the_more(
    direction, near, far, pads
):
    near, far = sorted((near, far))
    cube, offset, level = np.array([0.3, 0.0, 0.02]), np.array(direction), np.array([*direction[:2], 0.0])
    assert worth(cube, cube + near * offset, pads) >= worth(cube, cube + far * offset, pads) - 1e-6
    low, high = (cube + np.array([0.0, 0.0, share * 0.18]) for share in (near, far))
    assert worth(high, high, 1.0) >= worth(low, low, 1.0) - 1e-6
    close, away = (GOAL + share * level for share in (near, far))  # at the goal's height the lift is done
    assert worth(close, close, 1.0) >= worth(away, away, 1.0)


@given(places, places)
def test_each_pad_that_touches_is_worth_a_part(cube, tool):
    if away_from_the_goal(np.array(cube)):
        none, one, both = (worth(np.array(cube), np.array(tool), pads) for pads in (0.0, 0.5, 1.0))
        assert none < one < both
        np.testing.assert_allclose(both - none, 0.25, atol=1e-5)


@given(
    arrays(np.float32, (6, 7), elements=st.floats(-3, 3, width=32)),
    arrays(np.float32, (6, 3), elements=st.floats(-3, 3, width=32)),
)
def test_it_is_bounded_and_zero_exactly_where_the_goal_is_reached(achieved, desired):
    achieved[:, 6] = np.abs(np.round(achieved[:, 6])) % 3 / 2
    achieved[0, :3] = desired[0]
    rewards = RULE.reward(achieved, desired)
    assert rewards.dtype == np.float32
    assert ((rewards >= RULE.reward_range[0]) & (rewards <= RULE.reward_range[1])).all()
    assert (rewards[RULE.success(achieved, desired)] == 0).all()
    assert rewards[0] == 0


def test_each_stage_of_an_episode_is_worth_more_than_the_one_before():
    table, above = np.array([0.3, -0.1, 0.02]), np.array([0.3, -0.1, 0.2])
    beside = GOAL + np.array([0.06, 0.0, 0.0])
    stages = [
        worth(table, table + np.array([0.2, 0.1, 0.2]), 0.0),  # far
        worth(table, table, 0.0),  # reached
        worth(table, table, 1.0),  # grasped
        worth(above, above, 1.0),  # lifted
        worth(beside, beside, 1.0),  # nearly there
        worth(GOAL, GOAL, 1.0),
    ]
    assert stages == sorted(stages)
    assert len(set(stages)) == len(stages)
    assert stages[-1] == 0


@pytest.mark.parametrize("robot", ROBOTS)
def test_only_pads_that_face_each_other_around_the_cube_grip_it(robot):
    environment = made("pick_place", robot, reward="dense", start_grasped=1.0)
    held = environment.reset(0)
    close = np.array([0, 0, 0, -1], np.float32)
    for _ in range(6):
        held = environment.step(close)
    assert held.achieved_goal[6] == 1
    environment = made("pick_place", robot, reward="dense")
    environment.reset(1)
    view = environment.robot
    for step in range(45):  # the closed gripper comes down on top of the cube
        x, y, z = environment.task.cube.position
        pressed = environment.step(view.towards((x, y, 0.15 if step < 20 else z), 0.0))
    assert view.pads_touching(environment.task.cube.body) > 0
    assert pressed.achieved_goal[6] == 0
