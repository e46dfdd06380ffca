"""Insertion: starts, what is known of the hole, force, and that the hole is as wide as it says."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.closing import opened
from support.fourth_robot import ASKEW, HOME, small_arm
from support.rig import ENGINES, ROBOTS, expert_episode, made, part, values, world

from karolos.environments.robot_task import RobotTask
from karolos.errors import UsageError
from karolos.simulation.geometry import Box, rotated
from karolos.tasks.insert import TOP, Insert, block, peg

COLOUR = (1.0, 1.0, 1.0, 1.0)


def test_tests_start_above_the_hole_and_training_may_start_in_it():
    environment = made("insert")
    starts = np.stack([environment.reset(seed).achieved_goal for seed in range(20)])
    assert (np.abs(starts[:, :2]) <= 0.02 + 1e-6).all()
    assert starts[:, 2].min() > 0.02 - 1e-6
    assert starts[:, 2].max() < 0.05 + 1e-6
    for shape in ("square", "connector"):
        inside = made("insert", draws={"task.start_inserted": values(1.0)}, shape=shape)
        for seed in range(5):
            start = inside.reset(seed)
            assert -0.025 <= start.achieved_goal[2] <= 0
            after = inside.step(np.zeros(inside.signature.action.size, np.float32))
            assert after.achieved_goal[-1] == 0  # not squeezed by the walls
            assert abs(after.achieved_goal[0]) < 0.001


WAYS = [
    ("square", 0.0002, 0, True),
    ("square", -0.0002, 0, False),
    ("connector", 0.0002, 0, True),
    ("connector", -0.0002, 0, False),
    ("connector", 0.0002, np.pi, False),
]


@pytest.mark.parametrize(("shape", "play", "turn", "fits"), WAYS)
def test_a_peg_falls_into_a_hole_that_is_wider_and_into_no_other(shape, play, turn, fits):
    settings = Insert.Settings.model_validate({"chamfer": 0.0, "shape": shape}).model_copy(update={"play": play})
    empty = world("mujoco", substeps=10)
    hole = empty.body(block(settings), 0.0, COLOUR)
    falling = empty.body(peg(shape), 0.1, COLOUR)
    falling.set_inertia(0.1, (1.0, 1.0, 1.0))  # it does not tip where its ridge alone rests
    hole.place((0.0, 0.0, 0.0))
    falling.place((0.0, 0.0, TOP + 0.031), (0.0, 0.0, np.sin(turn / 2), np.cos(turn / 2)))
    for _ in range(20):
        empty.step()
    bottom = falling.pose()[0][2] - 0.03
    assert bottom == pytest.approx(0.005 if fits else TOP, abs=2e-4)


def test_every_arm_inserts_the_connector_which_it_holds_by_its_sides(tmp_path):
    arm = small_arm(tmp_path)
    arm.model = replace(arm.model, home=(*HOME[:5], ASKEW))  # its pads close along x, the others' along y
    task = Insert(Insert.Settings(shape="connector"))
    other = opened(RobotTask(RobotTask.Settings(), robot=arm(arm.Settings()), task=task))
    for environment in (other, *(made("insert", robot, shape="connector") for robot in ROBOTS)):
        environment.reset(0)
        held = rotated(environment.task.peg.pose()[1], (0.0, 1.0, 0.0))
        assert abs(np.dot(held, environment.robot.closing)) > 0.99
        if environment is not other:  # its grip of 15 N is weak
            episodes = [expert_episode(environment, seed) for seed in range(2)]
            assert all(steps[-1].success for steps in episodes)
            turned = [abs(steps[0].achieved_goal[5]) for steps in episodes]
            assert max(turned) < np.pi / 4 + 0.01


def test_every_arm_feels_its_way_into_a_tight_hole_that_it_does_not_know_exactly():
    how = {"play": 0.0002, "hole_error": 0.002, "hole_turn_error": 0.035}
    slow = {"tool_step": 0.005, "turn_step": 0.03}
    for robot in ROBOTS:
        environment = made("insert", robot, environment={"substeps": 20}, arm=slow, **how)
        assert environment.signature.observation.names[-1] == "touch"
        assert all(expert_episode(environment, seed)[-1].success for seed in range(2))


def test_policies_see_the_hole_as_it_is_known_and_critics_may_see_the_error():
    how = {"hole_error": 0.002, "hole_turn_error": 0.03}
    blind, seen = made("insert", **how), made("insert", environment={"critic_observes": ["hole_error"]}, **how)
    signature = seen.signature
    assert signature.observation.acting == blind.signature.observation
    errors = []
    for seed in range(10):
        step = seen.reset(seed)
        np.testing.assert_array_equal(step.observation[:-3], blind.reset(seed).observation)
        errors.append(step.observation[-3:])
        known = seen.task.known
        np.testing.assert_allclose(np.add(seen.task.block.pose()[0][:2], errors[-1][:2]), known[:2], atol=1e-6)
    assert np.ptp(errors, axis=0) == pytest.approx([0.003, 0.003, 0.045], rel=0.7)
    twice = made("insert", environment={"critic_observes": ["hole_error", "peg_forces", "hole_error"]}, **how)
    assert twice.signature.observation.names == (*signature.observation.names, "peg_forces")


def test_errors_of_the_hole_are_drawn_up_to_the_setting_which_policies_are_made_for():
    draws = {"task.hole_error": part("distributions", "uniform", low=0, high=0.005)}
    drawn = made("insert", draws=draws, hole_error=0.002)
    assert drawn.declared["task.hole_error"].high == 0.002


def test_a_round_peg_needs_no_actions_that_turn_the_tool():
    made("insert", arm={"control": "cartesian"}, shape="round")


def test_an_arm_that_does_not_get_down_to_the_hole_is_refused():
    robot = made("insert").robot
    box = robot.workspace
    low = Box((*box.low[:2], 0.1), box.high)
    view = SimpleNamespace(**{name: getattr(robot, name) for name in ("gripper", "orientations")}, workspace=low)
    with pytest.raises(UsageError, match=r"^task: the tool cannot be 0.055 m above the floor, where the peg is"):
        Insert(Insert.Settings()).fit(view)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_peg_weighs_what_was_drawn(engine):
    how = {"environment": {"engine": engine}, "arm": {"control": "joint"}}
    environment = made("insert", draws={"task.peg_mass": values(0.5)}, **how)
    environment.reset(0)
    environment.task.peg.place((0.0, 0.5, 0.031))
    for _ in range(12):
        environment.world.step()
    assert sum(environment.world.forces(environment.task.peg).values()) == pytest.approx(0.5 * 9.81, rel=0.01)


def test_a_force_above_the_limit_fails_the_episode_whatever_comes_later():
    environment = made("insert", force_limit=2.0)
    steps = expert_episode(environment, 0)
    measured = dict(zip([m.name for m in environment.signature.measures], environment.measures(), strict=True))
    deep = [abs(step.achieved_goal[2] + 0.025) < 0.001 for step in steps]
    assert deep[-1]
    assert not steps[-1].success
    assert measured["insertion_force"] > 2
