"""Augmented transitions are those of the same thing done elsewhere on the floor, and in a mirror."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from support.rig import ROBOTS, made

from bench.buffers import filled_buffer
from karolos.buffers.augmentation import Augmentation
from karolos.buffers.storage import StoredTransitions
from karolos.core import FloatArray, random_actions
from karolos.core.experience import transition_layout
from karolos.core.seeding import SeedTree
from karolos.environments.robot_task import RobotTask
from karolos.errors import UsageError
from karolos.plugins.inspection import pair
from karolos.simulation.geometry import rotation_about
from karolos.tasks.insert import TOP

STEPS = 10


def falling(environment: RobotTask, sign: int, way: Sequence[float]) -> None:
    """The tool is above a thing that falls, tilted, and tumbles; in a mirror (-1) or not (1), moved."""

    def there(x: float, y: float, z: float) -> tuple[float, float, float]:
        return x + way[0], sign * y + way[1], z

    robot, task = environment.robot, environment.task
    robot.place_tool(there(-0.05, 0.06, 0.15), 1.0)
    task.cube.place(there(0.06, -0.05, 0.06), rotation_about((0.5 * sign, 0.4, 0.3 * sign)))
    task.cube.body.set_velocity((0.1, 0.2 * sign, 0.0))
    task.goal = np.array((*there(-0.04, 0.05, 0.02), 1, 0, 0, 0, 1, 0)[: task.goal.size], np.float32)


def inserting(environment: RobotTask, sign: int, way: Sequence[float]) -> None:
    """A peg is above and beside its hole, turned; in a mirror or not, moved."""
    task, x, y, turn = environment.task, way[0], way[1], 0.1 * sign
    task.known, task.known_yaw = (x + 0.01, y + 0.02 * sign, TOP), turn
    task.block.place((*task.known[:2], 0.0), rotation_about((0.0, 0.0, turn)))
    task._hold((x + 0.015, y + 0.03 * sign, TOP + 0.02), -turn, 0.002, 0.001, 0.0)


def played(environment: RobotTask, begin: Callable[[], None], actions: FloatArray) -> StoredTransitions:
    """Transitions of an episode with these actions."""
    environment.reset(0)
    begin()
    environment.robot.read()
    environment.task.read()
    seen = np.stack([environment._observation(), *(environment.step(action).observation for action in actions)])
    rows = StoredTransitions(transition_layout(environment.signature), STEPS)
    rows["observation"][:], rows["next_observation"][:], rows["action"][:] = seen[:-1], seen[1:], actions
    rows["desired_goal"][:] = environment.task.goal
    return rows


@pytest.mark.parametrize(
    ("robot", "task", "begin", "arm"),
    [
        *((robot, "pick_place", falling, {"yaw": True}) for robot in ROBOTS),
        *((robot, "reorient", falling, {"control": "pose"}) for robot in ROBOTS),
        ("panda", "insert", inserting, {"control": "impedance", "turn_step": 0.03}),
    ],
)
def test_what_is_mirrored_and_moved_is_what_happens_there(robot, task, begin, arm):
    environment = made(task, robot, arm={"base": "centred", "reset_noise": 0.0, **arm})
    signature, way = environment.signature, (0.03, -0.04)
    actions = random_actions(signature, STEPS, SeedTree(0).generator())
    rows = played(environment, lambda: begin(environment, 1, (0.0, 0.0)), actions)
    everywhere = np.tile(np.array((*way, 0.0), np.float32), (STEPS, 1))
    Augmentation(Augmentation.Settings(), signature).change(rows, np.ones(STEPS, np.bool_), everywhere)
    found = played(environment, lambda: begin(environment, -1, way), rows["action"])
    for field in signature.observation.fields:
        columns = signature.observation.slice(field.name)
        expected = rows["next_observation"][:, columns]
        apart = np.abs(found["next_observation"][:, columns] - expected).max(axis=0)
        # A thing that nobody touches does the same; arms are a little askew, and near the end of what they can.
        alone = field.name.startswith("object") and field.name != "object_from_tool"
        near = 1e-3 if alone else 0.3 * np.ptp(expected, axis=0) + (0.02 if "errors" in field.name else 0.005)
        assert (apart <= near).all(), (field.name, apart, near)
    np.testing.assert_allclose(found["desired_goal"], rows["desired_goal"], atol=1e-6)


def test_a_batch_has_each_transition_at_its_place_in_a_mirror_or_not_and_rewards_that_fit_its_goals():
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


def test_what_is_lifted_moves_along_z_as_a_whole():
    signature = pair("panda", "reach").signature
    buffer = filled_buffer("uniform", signature, 4, 800, augmentation={"lift": 0.3, "shift": 0, "mirror": False})
    batch, goal = buffer.sample(256), buffer.storage.column("desired_goal", np.arange(len(buffer)))
    tool = signature.observation.slice("tool_position")
    flat = {tuple(row[:2]): row for row in goal}
    lifts = np.array([one[2] - flat[tuple(one[:2])][2] for one in batch.desired_goal])
    assert 0.25 < np.abs(lifts).max() < 0.301
    before = buffer.storage.column("observation", np.arange(len(buffer)))[:, tool]
    for one, lift in zip(batch.observation[:, tool], lifts, strict=True):
        assert np.abs(before - one + (0, 0, lift)).max(1).min() < 1e-6


def test_a_twist_turns_tool_and_goal_by_one_angle_about_their_own_z():
    signature = pair("panda", "reach_pose").signature
    rows = StoredTransitions(transition_layout(signature), 200)
    rows.table[:] = np.random.default_rng(0).normal(size=rows.table.shape)
    before, settings = rows.table.copy(), Augmentation.Settings(mirror=False, shift=0, twist=3.1)
    Augmentation(settings, signature).apply(rows, np.random.default_rng(1))
    fields = {"observation": "tool_rotation", "next_observation": "tool_rotation", "desired_goal": "goal_rotation"}
    columns = []
    for part, name in fields.items():
        place = getattr(signature, part.removeprefix("next_")).slice(name)
        columns.append(np.arange(before.shape[1])[transition_layout(signature).slice(part)][place])
    plain, turned = (table[:, columns].reshape(200, 3, 2, 3) for table in (before, rows.table))
    assert (np.abs(turned - plain).max((1, 2, 3)) > 0.1).mean() > 0.8
    z_before, z_after = (np.cross(frames[:, :, 0], frames[:, :, 1]) for frames in (plain, turned))
    np.testing.assert_allclose(z_after, z_before, atol=1e-5)
    between_before, between_after = (np.einsum("nijk,nljk->nil", frames, frames) for frames in (plain, turned))
    np.testing.assert_allclose(between_after, between_before, atol=1e-4)
    others = np.setdiff1d(np.arange(before.shape[1]), columns)
    np.testing.assert_array_equal(rows.table[:, others], before[:, others])


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"arm": {"control": "joint"}}, "it is unknown how joint_positions changes if the scene is mirrored or moved"),
        ({"environment": {"actions": "discrete"}}, "discrete actions have no mirror image"),
    ],
)
def test_what_has_no_mirror_image_is_refused(how, said):
    environment = made("push", **how)
    with pytest.raises(UsageError, match=said):
        Augmentation(Augmentation.Settings(), environment.signature)


def test_only_the_first_batches_are_changed_also_when_a_state_is_loaded():
    signature = pair("panda", "push").signature
    buffer, other = (  # sampled once
        filled_buffer("uniform", signature, 4, 800, augmentation={"batches": 3, "mirror": False}) for _ in range(2)
    )
    stored = set(map(bytes, buffer.storage.column("observation", np.arange(len(buffer)))))

    def changed() -> bool:
        return not stored >= set(map(bytes, buffer.sample(16).observation))

    assert changed()
    other.load_state(buffer.state())
    buffer = other
    assert [changed() for _ in range(3)] == [True, False, False]
