"""Insertion: starts, what is known of the hole, force, and that the hole is as wide as it says."""

from __future__ import annotations

import numpy as np
import pytest
from support.rig import expert_episode, made, values

from karolos.simulation.engines import make_world
from karolos.simulation.shapes import Cuboid
from karolos.tasks.insert import TOP, Insert, block

COLOUR = (1.0, 1.0, 1.0, 1.0)


def test_tests_start_above_the_hole_and_training_may_start_in_it():
    environment = made("insert")
    starts = np.stack([environment.reset(seed).achieved_goal for seed in range(40)])
    environment.close()
    assert (np.abs(starts[:, :2]) <= 0.02 + 1e-6).all()
    assert starts[:, 2].min() > 0.02 - 1e-6
    assert starts[:, 2].max() < 0.05 + 1e-6
    inside = made("insert", draws={"task.start_inserted": values(1.0)})
    for seed in range(10):
        start = inside.reset(seed)
        assert -0.025 <= start.achieved_goal[2] <= 0
        after = inside.step(np.zeros(inside.signature.action.size, np.float32))
        assert after.achieved_goal[-1] == 0  # not squeezed by the walls
        assert abs(after.achieved_goal[0]) < 0.001
    inside.close()


@pytest.mark.parametrize(("play", "fits"), [(0.0002, True), (-0.0002, False)])
def test_a_peg_falls_into_a_hole_that_is_wider_and_into_no_other(play, fits):
    settings = Insert.Settings.model_validate({"chamfer": 0.0}).model_copy(update={"play": play})
    world = make_world("mujoco", substeps=10)
    hole = world.body(block(settings), 0.0, COLOUR)
    peg = world.body([Cuboid((0.02, 0.02, 0.06))], 0.1, COLOUR)
    hole.place((0.0, 0.0, 0.0))
    peg.place((0.0, 0.0, TOP + 0.031))
    for _ in range(20):
        world.step()
    bottom = peg.pose()[0][2] - 0.03
    world.close()
    assert bottom == pytest.approx(0.005 if fits else TOP, abs=2e-4)


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
    blind.close()
    seen.close()


def test_a_force_above_the_limit_fails_the_episode_whatever_comes_later():
    environment = made("insert", force_limit=2.0)
    steps = expert_episode(environment, 0)
    measured = dict(zip([m.name for m in environment.signature.measures], environment.measures(), strict=True))
    environment.close()
    deep = [abs(step.achieved_goal[2] + 0.025) < 0.001 for step in steps]
    assert deep[-1]
    assert not steps[-1].success
    assert measured["insertion_force"] > 2
