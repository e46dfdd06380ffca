"""Augmented transitions are those of the same thing done elsewhere on the floor, and in a mirror."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from support.rig import ROBOTS, made

from bench.buffers import filled_buffer
from karolos.buffers.augmentation import Augmentation
from karolos.core import FloatArray, random_actions
from karolos.core.seeding import SeedTree
from karolos.environments.robot_task import RobotTask
from karolos.errors import UsageError
from karolos.plugins.inspection import pair
from karolos.simulation.geometry import rotation_about
from karolos.tasks.insert import TOP

STEPS = 10


def played(environment: RobotTask, actions: FloatArray, sign: int, way: Sequence[float]) -> dict[str, FloatArray]:
    """Rows of an episode: the tool moves over a thing that falls, tilted, and tumbles; in a mirror (-1) or not (1)."""

    def there(x: float, y: float, z: float) -> tuple[float, float, float]:
        return x + way[0], sign * y + way[1], z

    environment.reset(0)
    robot, task = environment.robot, environment.task
    robot.place_tool(there(-0.05, 0.06, 0.15), 1.0)
    task.cube.place(there(0.06, -0.05, 0.06), rotation_about((0.5 * sign, 0.4, 0.3 * sign)))
    task.cube.body.set_velocity((0.1, 0.2 * sign, 0.0))
    task.goal = np.array((*there(-0.04, 0.05, 0.02), 1, 0, 0, 0, 1, 0)[: task.goal.size], np.float32)
    robot.read()
    task.read()
    steps = [environment._observation(), *(environment.step(action).observation for action in actions)]
    seen = np.stack(steps)
    goals = np.repeat(task.goal[np.newaxis], STEPS, axis=0)
    return {
        "observation": seen[:-1].copy(),
        "next_observation": seen[1:].copy(),
        "action": actions.copy(),
        "desired_goal": goals,
    }


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize(("task", "arm"), [("pick_place", {"yaw": True}), ("reorient", {"control": "pose"})])
def test_what_is_mirrored_and_moved_is_what_happens_there(robot: str, task: str, arm: dict) -> None:
    environment = made(task, robot, arm={"base": "centred", "reset_noise": 0.0, **arm})
    signature, way = environment.signature, (0.03, -0.04)
    actions = random_actions(signature, STEPS, SeedTree(0).generator())
    rows = played(environment, actions, 1, (0.0, 0.0))
    augmentation = Augmentation(Augmentation.Settings(), signature)
    augmentation.mirror(rows, np.ones((STEPS, 1), np.bool_))
    augmentation.move(rows, np.array([way], np.float32))
    found = played(environment, rows["action"], -1, way)
    environment.close()
    for field in signature.observation.fields:
        columns = signature.observation.slice(field.name)
        here, expected = found["next_observation"][:, columns], rows["next_observation"][:, columns]
        apart = np.abs(here - expected).max()
        # A thing that nobody touches does the same; arms are a little askew, and near the end of what they can.
        assert apart < (
            1e-3 if field.name.startswith("object") and field.name != "object_from_tool" else 0.2 * np.ptp(expected)
        ), field.name
    np.testing.assert_allclose(found["desired_goal"], rows["desired_goal"], atol=1e-6)


def test_a_batch_has_each_transition_at_its_place_in_a_mirror_or_not_and_rewards_that_fit_its_goals() -> None:
    signature = pair("panda", "push").signature
    buffer = filled_buffer("uniform", signature, 4, 800, hindsight={}, augmentation={"shift": 0.2})
    stored, batch = buffer.storage.table, buffer.sample(256)
    places = signature.observation.slice("object_position")
    height = stored[:, places.start + 2]
    below = np.array([np.flatnonzero(height == z)[0] for z in batch.observation[:, places.start + 2]])
    before, velocity = stored[below], signature.observation.slice("object_velocity")
    mirrored = batch.observation[:, velocity.start + 1] == -before[:, velocity.start + 1]
    assert 0.35 < mirrored.mean() < 0.65
    assert (mirrored | (batch.observation[:, velocity.start + 1] == before[:, velocity.start + 1])).all()
    signs = np.where(mirrored[:, np.newaxis], (1, -1, 1), 1)
    moved = batch.observation[:, places] - signs * before[:, places]
    assert 0.19 < np.abs(moved[:, :2]).max() < 0.201
    achieved = buffer.storage.column("next_achieved_goal", below) * signs + moved
    assert (signature.goal_rule.reward(achieved, batch.desired_goal) == batch.reward).all()
    assert 0.05 < (batch.reward == 0).mean() < 0.95


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"arm": {"control": "joint"}}, "what becomes of joint_positions in a mirror or elsewhere is not known"),
        ({"environment": {"actions": "discrete"}}, "discrete actions have no mirror image"),
    ],
)
def test_what_has_no_mirror_image_is_refused(how: dict, said: str) -> None:
    environment = made("push", **how)
    with pytest.raises(UsageError, match=said):
        Augmentation(Augmentation.Settings(), environment.signature)
    environment.close()


def inserting(environment: RobotTask, actions: FloatArray, sign: int) -> dict[str, FloatArray]:
    """Rows of an episode: a peg beside and above its hole, turned; in a mirror (-1) or not (1)."""
    environment.reset(0)
    task, (x, y), turn = environment.task, environment.task.middle, 0.1 * sign
    task.known, task.known_yaw = (x + 0.01, y + 0.02 * sign, TOP), turn
    task.block.place((*task.known[:2], 0.0), rotation_about((0.0, 0.0, turn)))
    task._hold((x + 0.015, y + 0.03 * sign, TOP + 0.02), -turn, 0.002, 0.001, 0.0)
    environment.robot.read()
    task.read()
    seen = np.stack([environment._observation(), *(environment.step(action).observation for action in actions)])
    goals = np.repeat(task.goal[np.newaxis], STEPS, axis=0)
    return {"observation": seen[:-1].copy(), "next_observation": seen[1:].copy(), "action": actions.copy()} | {
        "desired_goal": goals
    }


def test_a_peg_does_in_a_mirror_what_its_fields_say() -> None:
    environment = made("insert", arm={"base": "centred", "control": "impedance", "turn_step": 0.03, "reset_noise": 0.0})
    actions = random_actions(environment.signature, STEPS, SeedTree(0).generator())
    rows = inserting(environment, actions, 1)
    Augmentation(Augmentation.Settings(), environment.signature).mirror(rows, np.ones((STEPS, 1), np.bool_))
    found = inserting(environment, rows["action"], -1)
    environment.close()
    for field in environment.signature.observation.fields:
        columns = environment.signature.observation.slice(field.name)
        here, expected = found["next_observation"][:, columns], rows["next_observation"][:, columns]
        near = 0.3 * np.ptp(expected, axis=0) + (0.02 if field.name == "near_errors" else 1e-3)
        assert (np.abs(here - expected).max(axis=0) <= near).all(), field.name
