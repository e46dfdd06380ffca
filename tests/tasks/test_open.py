"""Opening: drawer and door are opened and closed by their handles, and starts are what they say."""

import numpy as np
import pytest
from support.rig import ROBOTS, expert_episode, made, values

from karolos.simulation.geometry import inverse, rotated


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_expert_opens_and_closes_a_door_with_every_arm(robot):
    environment = made("open", robot, mechanism="door")
    further = []
    for seed in range(5):
        steps = expert_episode(environment, seed)
        assert steps[-1].success
        further.append(steps[0].desired_goal[0] > steps[0].achieved_goal[0])
    assert 0 < sum(further) < 5


@pytest.mark.parametrize(("start", "most"), [("start_near", 0.081), ("start_hooked", 0.001)])
def test_training_may_start_above_the_handle_or_behind_its_bar_and_touches_nothing(start, most):
    environment = made("open", draws={f"task.{start}": values(1.0)}, mechanism="door")
    away = environment.signature.observation.slice("handle_from_tool")
    for seed in range(20):
        begin = environment.reset(seed)
        assert np.linalg.norm(begin.observation[away]) < most
        after = environment.step(np.zeros(3, np.float32))
        np.testing.assert_allclose(after.achieved_goal, begin.achieved_goal, atol=1e-5)
        assert not begin.success


@pytest.mark.parametrize("mechanism", ["drawer", "door"])
def test_a_hooked_handle_moves_as_the_world_says_and_its_friction_holds_it(mechanism):
    environment = made("open", mechanism=mechanism, start_hooked=1.0)
    forces = []
    for friction in (0.0, 20.0):
        environment.task.apply(environment.world, "joint_friction", friction)
        begin = environment.reset(3)
        ahead = np.sign(begin.desired_goal[0] - begin.achieved_goal[0]) * np.array(
            [*environment.task.direction_at(environment.task.position), 0.0], np.float32
        )
        felt = []
        for _ in range(8):
            step = environment.step(0.4 * ahead)
            felt.append(environment.robot.largest_force())
        forces.append(np.median(felt[-3:]))
        moved = step.achieved_goal - begin.achieved_goal
        assert np.linalg.norm(moved[1:]) > 0.01
        link = environment.task.piece.link(environment.task.link)
        away = np.subtract(environment.task.handle_at(environment.task.position), link.position)
        own = rotated(inverse(link.orientation), away)
        np.testing.assert_allclose(own[:2], environment.task.handle, atol=1e-3)
    assert forces[1] > forces[0] + 15
