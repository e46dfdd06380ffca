"""Pick-and-place, push and stack: placed honestly, what counts as success, starts by stages."""

from typing import Any

import numpy as np
import pytest
from support.rig import ENGINES, ROBOTS, expert_episode, made, values

from karolos.tasks.slide import Rest

CUBE_TASKS = ["pick_place", "push"]


@pytest.mark.parametrize("task", CUBE_TASKS)
def test_goals_are_never_solved_at_reset_and_lie_where_they_should(task):
    environment = made(task)
    starts = [environment.reset(seed) for seed in range(60)]
    goals = np.stack([step.desired_goal for step in starts])
    cubes = np.stack([step.achieved_goal[:3] for step in starts])
    assert not any(step.success for step in starts)
    assert (np.ptp(goals[:, :2], axis=0) <= 0.3 + 1e-6).all()
    assert (np.ptp(cubes[:, :2], axis=0) <= 0.3 + 1e-6).all()
    np.testing.assert_allclose(cubes[:, 2], 0.02, atol=2e-3)
    on_surface = np.isclose(goals[:, 2], 0.02, atol=2e-3)
    if task == "push":
        assert on_surface.all()
    else:
        assert 0.1 < on_surface.mean() < 0.5
        assert goals[:, 2].max() <= 0.2 + 0.021


@pytest.mark.parametrize("task", CUBE_TASKS)
def test_dense_rewards_follow_from_the_goals_lie_in_their_range_and_end_higher_than_they_began(task):
    """Hindsight can compute them anew."""
    environment = made(task, reward="dense")
    rule, (low, high) = environment.signature.goal_rule, environment.signature.reward_range
    steps = expert_episode(environment, 3)[1:]
    achieved, desired = (np.stack(goals) for goals in zip(*(step[1:3] for step in steps), strict=True))
    rewards = np.array([step.reward for step in steps])
    assert (rewards >= low).all()
    assert (rewards <= high).all()
    assert rewards[-5:].mean() > rewards[:5].mean()
    np.testing.assert_array_equal(rule.reward(achieved, desired), rewards.astype(np.float32))
    np.testing.assert_array_equal(rule.success(achieved, desired), [step.success for step in steps])
    relabelled = rule.reward(achieved, np.broadcast_to(achieved[-1, :3], desired.shape))
    assert relabelled[-1] == 0 > relabelled[0]


UP = "tool_position_change z +"


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize(
    ("how", "actions"),
    [
        ({}, [[0, 0, 1, -1]] * 20),  # up, gripper closed
        ({"draws": {"robot.action_delay": values(2.0)}}, [[0, 0, 1, -1]] * 20),
        ({"environment": {"actions": "discrete"}}, ["nothing"] * 8 + [UP] * 8 + ["nothing"] * 8),
    ],
    ids=["at once", "delayed", "discrete"],
)
def test_a_cube_that_starts_grasped_is_in_the_hand_and_is_lifted_with_it(robot, how, actions):
    environment = made("pick_place", robot, start_grasped=1.0, **how)
    tool = environment.signature.observation.slice("tool_position")
    for seed in range(3):
        start = environment.reset(seed)
        assert np.linalg.norm(start.achieved_goal - start.observation[tool]) < 0.01
        for action in actions:
            number = environment.signature.action.labels.index(action) if isinstance(action, str) else action
            step = environment.step(np.array(number, np.float32))
        assert environment.task.cube.lowest > 0.08
        assert np.linalg.norm(step.achieved_goal - step.observation[tool]) < 0.02


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize(("task", "closest", "furthest"), [("push", 0.055, 0.224), ("pick_place", 0.006, 0.08)])
def test_an_episode_that_starts_near_the_cube_does_not_touch_it(robot, task, closest, furthest):
    environment = made(task, robot, start_near=1.0)
    tool, rest = environment.signature.observation.slice("tool_position"), np.zeros(environment.signature.action.size)
    rest[3:] = 1.0  # an open gripper stays open
    for seed in range(20):
        start = environment.reset(seed)
        distance = np.linalg.norm(start.achieved_goal[:3] - start.observation[tool])
        assert closest - 0.002 < distance < furthest + 0.002
        for _ in range(5):
            step = environment.step(rest)
        assert np.linalg.norm(step.achieved_goal[:3] - start.achieved_goal[:3]) < 1e-4
        assert np.linalg.norm(step.observation[tool] - start.observation[tool]) < 0.002
    again = environment.reset(19)
    assert again.observation.tolist() == environment.reset(19).observation.tolist() == start.observation.tolist()


def test_half_of_the_pushes_that_start_near_the_cube_start_above_the_floor():
    environment = made("push", start_near=1.0)
    tool = environment.signature.observation.slice("tool_position")
    heights = np.array([environment.reset(seed).observation[tool][2] for seed in range(200)])
    above = heights - heights.min()
    assert np.mean(above > 0.005) == pytest.approx(0.5, abs=0.1)
    assert 0.09 < above.max() <= 0.102


@pytest.mark.parametrize(("grasped", "near", "expected"), [(0.0, 0.4, 0.4), (0.5, 0.4, 0.2), (1.0, 1.0, 0.0)])
def test_start_near_is_the_share_of_the_episodes_that_do_not_start_grasped(grasped, near, expected):
    environment = made("pick_place", start_grasped=grasped, start_near=near)
    opening = environment.signature.observation.slice("gripper_opening")
    tool = environment.signature.observation.slice("tool_position")
    starts = [environment.reset(seed) for seed in range(200)]
    held = [start.observation[opening][0] < 0.6 for start in starts]
    close = [np.linalg.norm((start.achieved_goal[:3] - start.observation[tool])[:2]) < 0.01 for start in starts]
    assert np.mean(held) == pytest.approx(grasped, abs=0.08)
    assert np.mean(close) - np.mean(held) == pytest.approx(expected, abs=0.08)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_stack_counts_only_where_cubes_stand_on_each_other_and_nothing_holds_them(engine):
    environment = made("stack", environment={"engine": engine}, start_above=1.0)
    still = np.zeros(environment.signature.action.size, np.float32)
    held = environment.reset(0)
    assert not held.success
    (x, y, z), lower = environment.task.cube.position, environment.task.cubes[1]
    for place, opening, counts in [
        ((x, y, z + 0.04), -1.0, False),  # in the hand, if that is just above the other
        ((x + 0.041, y, z), 1.0, False),
        ((x + 0.016, y, z + 0.04), 1.0, False),
        ((x + 0.012, y, z + 0.04), 1.0, True),
    ]:
        still[3] = opening
        if opening > 0:
            for _ in range(12):  # out of the way
                environment.step(np.array([0, 0, 1, 1], np.float32))
            lower.place(place)
        for _ in range(4):
            step = environment.step(still)
        assert step.success == counts, place
    lower.body.set_velocity((0.0, 0.0, 1.0))
    assert not environment.step(still).success


def test_some_goals_of_training_are_a_cube_that_is_held_in_the_air():
    environment, plain = made("stack", goal_held=0.5), made("stack")
    goals = []
    for seed in range(60):
        start, usual = environment.reset(seed), plain.reset(seed)
        assert start.achieved_goal.tolist() == usual.achieved_goal.tolist()
        assert usual.desired_goal.tolist() == pytest.approx([0, 0, 0.04, 1])
        goals.append(start.desired_goal)
    stacked = [goal.tolist() == usual.desired_goal.tolist() for goal in goals]
    assert np.mean(stacked) == pytest.approx(0.5, abs=0.2)
    held = np.stack([goal for goal, one in zip(goals, stacked, strict=True) if not one])
    assert (held[:, 3] == 0).all()  # in the hand or not
    assert held[:, 2].min() > 0.04
    assert 0.15 < held[:, 2].max() < 0.19
    assert np.abs(held[:, :2]).max() > 0.05


@pytest.mark.parametrize(("stacked", "height"), [(0.0, 0.02), (1.0, 0.06)])
def test_three_cubes_are_stacked_from_the_floor_or_from_two(stacked, height):
    environment = made("stack", height=3, max_steps=200, start_stacked=stacked)
    steps = expert_episode(environment, 1)
    second = environment.signature.observation.slice("cube_2_position")
    assert steps[0].observation[second][2] == pytest.approx(height, abs=1e-3)
    assert not steps[0].success
    assert steps[-1].success


@pytest.mark.parametrize("engine", ENGINES)
def test_a_puck_comes_to_rest_where_it_is_computed_to_and_counts_only_then(engine):
    environment = made("slide", environment={"engine": engine}, max_steps=240)
    steps = expert_episode(environment, 1)
    left = max(k for k, step in enumerate(steps) if step.reward < 0) + 1  # from here on it is on its way
    assert not any(step.success for step in steps[: left + 1])
    assert steps[-1].success
    ends = [steps[k].achieved_goal[:2] for k in (left + 12, -1)]
    np.testing.assert_allclose(*ends, atol=2e-3 if engine == "mujoco" else 0.02)
    place = environment.task.cube.position
    np.testing.assert_allclose(place[:2], ends[1], atol=1e-3)
    assert np.hypot(*place[:2]) > environment.robot.workspace.high[0]
    assert environment.task.nearest - 0.05 == pytest.approx(made("throw").task.planner.reach, abs=5e-3)


def test_a_slide_may_succeed_where_it_is_not_rewarded():
    rule = Rest(0.05, dense=False, span=1.0, reward_share=0.7)
    achieved = np.array([[0.03, 0, 1], [0.04, 0, 1], [0.06, 0, 1], [0.03, 0, 0]], np.float32)
    target = np.zeros((4, 2), np.float32)
    assert rule.reward(achieved, target).tolist() == [0, -1, -1, 0]
    sloped = Rest(0.05, dense=False, span=1.0, reward_share=0.7, slope=0.35)
    np.testing.assert_allclose(sloped.reward(achieved, target), [-0.3, -1, -1, -0.3], rtol=1e-5)
    assert rule.success(achieved, target).tolist() == [True, True, False, False]


def test_an_episode_that_ends_out_of_reach_is_truncated_with_the_puck_on_its_way():
    environment = made("slide", end_out_of_reach=1.0, max_steps=240)
    steps = expert_episode(environment, 1)
    assert steps[-1].truncated
    assert not steps[-1].success
    assert steps[-1].reward == 0
    assert not environment.task.lies
    assert not environment.robot.workspace.contains(environment.task.cube.position)


@pytest.mark.parametrize("task", ["pick_place", "push", "throw"])
def test_observation_noise_is_on_the_object_too_and_nothing_gives_the_tool_away(task):
    noise = 0.05
    draws = {"robot.observation_noise": values(noise)}
    environment = made(task, draws=draws)
    field = environment.signature.observation.slice
    errors = []
    for seed in range(40):
        step = environment.reset(seed)
        seen = step.observation
        errors.append(seen[field("object_position")] - environment.task.cube.position)
        tool = seen[field("object_position")] - seen[field("object_from_tool")]
        np.testing.assert_allclose(tool, seen[field("tool_position")], atol=1e-6)
        assert np.abs(tool - environment.robot.tool_position).max() > 1e-4
    assert np.std(errors) == pytest.approx(noise, rel=0.25)


def episode(task: str, **parameters: float) -> tuple[Any, list[Any]]:
    """An episode of the same actions under these parameters of the robot."""
    environment = made(task, draws={f"robot.{name}": values(value) for name, value in parameters.items()})
    generator, steps = np.random.default_rng(5), [environment.reset(3)]
    size = environment.signature.action.size
    steps += [environment.step(generator.uniform(-1, 1, size).astype(np.float32)) for _ in range(12)]
    return environment, steps


@pytest.mark.parametrize("task", ["pick_place", "push", "insert", "open"])
def test_late_observations_are_those_of_before_and_change_nothing_else(task):
    environment, plain = episode(task)
    period = 1 / environment.rate
    late, between = (episode(task, latency=share * period)[1] for share in (1, 0.25))
    for before, now, whole, quarter in zip(plain, plain[1:], late[1:], between[1:], strict=False):
        np.testing.assert_allclose(whole.observation, before.observation, atol=1e-6)
        mixed = 0.75 * now.observation + 0.25 * before.observation
        np.testing.assert_allclose(quarter.observation, mixed, atol=1e-6)
        np.testing.assert_array_equal(whole.achieved_goal, now.achieved_goal)
    np.testing.assert_array_equal(late[0].observation, plain[0].observation)


def test_jitter_makes_observations_older_by_up_to_as_much():
    environment, plain = episode("push")
    _, varied = episode("push", jitter=0.5 / environment.rate)
    shares = []
    for before, now, seen in zip(plain, plain[1:], varied[1:], strict=False):
        way = before.observation - now.observation
        shares.append(float((seen.observation - now.observation) @ way / (way @ way)))
    assert -1e-4 < min(shares) < 0.2
    assert 0.3 < max(shares) < 0.5001


@pytest.mark.parametrize(
    ("task", "shifted"),
    [
        ("pick_place", ["object_position", "object_from_tool"]),
        ("stack", ["cube_1_position", "cube_1_from_tool", "cube_2_position", "cube_2_from_tool"]),
        ("insert", ["tip_from_hole"]),
        ("open", ["handle_position", "handle_from_tool"]),
    ],
)
def test_a_calibration_error_is_where_cameras_see_things_all_along_an_episode(task, shifted):
    environment, plain = episode(task)
    off = [
        (seen.observation - true.observation)
        for seen, true in zip(episode(task, calibration_error=0.01)[1], plain, strict=True)
    ]
    names, field = environment.signature.observation.names, environment.signature.observation.slice
    first = off[0][field(shifted[0])]
    assert 0.0001 < np.abs(first).max() <= 0.01
    for name in names:
        if name == "near_errors":  # of tip_from_hole
            continue
        for one in off:
            wanted = first if name in shifted else np.zeros_like(one[field(name)])
            np.testing.assert_allclose(one[field(name)], wanted, atol=1e-6, err_msg=name)
