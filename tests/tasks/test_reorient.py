"""Reorienting: a cylinder is brought to its pose, objects lie or stand, and starts are what they say."""

import numpy as np
import pytest
from support.rig import expert_episode, made, values

from karolos.simulation.geometry import axes
from karolos.tasks.reorient import LYING


def test_the_expert_brings_a_cylinder_to_its_pose():
    environment = made("reorient", "ur5", shape="cylinder")
    stood = []
    for seed in range(4):
        steps = expert_episode(environment, seed)
        assert steps[-1].success
        assert not steps[0].success
        stood.append(abs(axes(environment.task.goal_rotation)[2][2]) > 0.7)
    assert 0 < sum(stood) < 4


@pytest.mark.parametrize("shape", ["box", "cylinder"])
@pytest.mark.parametrize("start", ["start_carried", "start_grasped", "start_near"])
def test_training_may_start_with_the_object_in_the_hand_or_near_it(start, shape):
    environment = made("reorient", draws={f"task.{start}": values(1.0)}, shape=shape)
    layout = environment.signature.observation
    action = np.zeros(environment.signature.action.size, np.float32)
    action[-1] = 1.0 if start == "start_near" else -1.0
    heights = []
    for seed in range(5):
        begin = environment.reset(seed)
        heights.append(environment.task.cube.lowest)
        for _ in range(6):
            after = environment.step(action)
        np.testing.assert_allclose(after.achieved_goal, begin.achieved_goal, atol=0.02)
        assert np.linalg.norm(after.observation[layout.slice("object_from_tool")]) < 0.1
    assert min(heights) == pytest.approx(0.0, abs=1e-3) or start == "start_carried"
    assert (max(heights) > 0.05) == (start == "start_carried")


def test_training_may_start_with_the_gripper_right_over_the_object_turned_away_and_partly_closed():
    environment = made("reorient", draws={"task.start_over": values(1.0)})
    layout = environment.signature.observation
    still = np.zeros(environment.signature.action.size, np.float32)
    openings, apart = [], []
    for seed in range(20):
        begin = environment.reset(seed)
        piece, (along, side, _) = environment.task.cube, environment.robot.closing
        still[-1] = 2 * begin.observation[layout.slice("gripper_opening")][0] - 1
        x, y, z = begin.observation[layout.slice("object_from_tool")]
        assert np.hypot(x, y) < 1e-3
        assert -0.11 < z < -0.02
        openings.append(begin.observation[layout.slice("gripper_opening")][0])
        turn = (np.arctan2(side, along) - piece.across()) % np.pi
        apart.append(min(turn, np.pi - turn))
        for _ in range(3):
            after = environment.step(still)
        np.testing.assert_allclose(after.achieved_goal, begin.achieved_goal, atol=1e-3)
    assert min(openings) < 0.3
    assert max(openings) > 0.7
    assert max(apart) > 0.5


def test_a_box_that_has_toppled_costs_more_and_may_end_the_episode():
    environment = made("reorient", topple_cost=0.5, lying=0.0, draws={"task.end_toppled": values(1.0)})
    still = np.zeros(environment.signature.action.size, np.float32)
    environment.reset(0)
    piece = environment.task.cube
    standing = environment.step(still)
    assert (standing.reward, standing.truncated) == (-1.0, False)
    piece.place((*piece.position[:2], piece.edges[0] / 2), LYING)
    lying = environment.step(still)
    assert (lying.reward, lying.truncated, lying.terminated) == (-1.5, True, False)
    assert environment.signature.extra_reward == (-0.5, 0.0)


def test_a_box_that_lies_at_the_start_has_not_toppled():
    environment = made("reorient", topple_cost=0.5, lying=1.0)
    environment.reset(0)
    step = environment.step(np.zeros(environment.signature.action.size, np.float32))
    assert (step.reward, step.truncated) == (-1.0, False)
