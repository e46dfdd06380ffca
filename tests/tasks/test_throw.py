"""Throw: what lands where, and that every robot can do it."""

import numpy as np
import pytest
from support.rig import ENGINES, ROBOTS, expert_episode, made, values

from karolos.environments.robot_task import RobotTask
from karolos.tasks.throw import Throw
from karolos.tasks.throw_planner import flight_time

REACH_AND_FURTHEST = {"panda": (0.95, 1.13), "ur5": (1.06, 1.21), "iiwa": (1.08, 1.73)}
"""m, as the task's docstring states them."""


def holding(environment: RobotTask) -> np.ndarray:
    """The action that keeps still with the gripper closed."""
    action = np.zeros(environment.signature.action.size, np.float32)
    action[-1] = -1
    return action


@pytest.mark.parametrize("robot", ROBOTS)
def test_reach_and_furthest_throw_are_those_the_docstring_states(robot):
    planner = made("throw", robot).task.planner
    reach, furthest = REACH_AND_FURTHEST[robot]
    assert round(planner.reach, 2) == reach
    assert round(planner.furthest, 2) == furthest
    assert f"{robot} {reach:.2f} and {furthest:.2f} m".replace(" 0.", " .") in (Throw.__doc__ or "")


@pytest.mark.parametrize("robot", ROBOTS)
def test_no_pose_reaches_further_than_the_reach(robot):
    environment = made("throw", robot)
    view, draws = environment.robot, np.random.default_rng(0)
    low, high = np.maximum(view.limits.lower, -np.pi), np.minimum(view.limits.upper, np.pi)
    tools = [view.forward(draws.uniform(low, high).tolist()).tool.position for _ in range(3000)]
    assert np.hypot(*np.array(tools)[:, :2].T).max() <= environment.task.planner.reach + 0.002


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_planned_throw_keeps_the_speed_limits_and_lands_on_its_target_by_the_whole_jacobian(robot):
    environment = made("throw", robot)
    task, view = environment.task, environment.robot
    for angle in (-0.5, 0.0, 0.4):
        for far in np.linspace(task.nearest, task.furthest, 4):
            target = far * np.array([np.cos(angle), np.sin(angle)])
            throw = task.planner.plan(*target)
            assert (np.abs(throw.velocities) <= np.array(view.limits.velocity) + 1e-9).all()
            at = view.forward(throw.release)
            places = np.array(at.axes).reshape(-1, 6)
            arms = np.cross(places[:, 3:], np.array(at.tool.position) - places[:, :3])
            velocity = np.array(throw.velocities) @ arms
            height = at.tool.position[2] - 0.02
            seconds = (velocity[2] + np.sqrt(velocity[2] ** 2 + 2 * 9.81 * height)) / 9.81
            landing = np.array(at.tool.position)[:2] + velocity[:2] * seconds
            assert np.linalg.norm(landing - target) < 0.01


def test_targets_lie_beyond_the_reach_and_within_the_furthest_throw():
    environment = made("throw", sector=20)
    task = environment.task
    starts = [environment.reset(seed) for seed in range(40)]
    targets = np.stack([step.desired_goal for step in starts])
    away = np.hypot(*targets.T)
    assert (away >= task.planner.reach + task.settings.threshold - 1e-5).all()
    assert (away <= task.furthest + 1e-5).all()
    assert task.furthest < task.planner.furthest
    assert np.ptp(away) > 0.05
    assert (np.abs(np.degrees(np.arctan2(targets[:, 1], targets[:, 0]))) <= 20.001).all()
    assert not any(step.success or step.terminated for step in starts)


def test_the_cube_starts_in_the_gripper_and_stays_there_while_it_is_held():
    environment = made("throw")
    tool = environment.signature.observation.slice("tool_position")
    cube = environment.signature.observation.slice("object_position")
    steps = [environment.reset(3)]
    steps += [environment.step(holding(environment)) for _ in range(10)]
    for step in steps:
        assert np.linalg.norm(step.observation[tool] - step.observation[cube]) < 0.005
        assert step.achieved_goal[2] == 0
        assert step.reward == 0


def test_the_landing_is_where_free_fall_from_the_release_comes_down_not_where_the_cube_slides_to():
    environment = made("throw")
    task = environment.task
    steps = expert_episode(environment, 5)
    position = environment.signature.observation.slice("object_position")
    velocity = environment.signature.observation.slice("object_velocity")
    flying = [step.observation for step in steps if step.observation[position][2] > 0.15][-1]
    place, speed = flying[position].astype(float), flying[velocity].astype(float)
    landing = steps[-1].achieved_goal
    for height in (0.02, 0.02 * 3**0.5):  # of the centre: on a face, on a corner
        seconds = (speed[2] + np.sqrt(speed[2] ** 2 + 2 * 9.81 * (place[2] - height))) / 9.81
        straight = place[:2] + speed[:2] * seconds
        assert np.linalg.norm(landing[:2] - straight) < 0.03
    world = environment.world
    for _ in range(48):  # what the cube does afterwards moves no landing
        world.step()
        task.read()
    assert np.linalg.norm(np.array(task.cube.position[:2]) - landing[:2]) > 0.005
    np.testing.assert_array_equal(task.achieved(), landing)
    flight, *cross = task.strokes()
    np.testing.assert_allclose(flight.points[-1][:2], landing[:2], atol=1e-6)
    assert len(cross) == 2


def test_a_cube_that_is_dropped_lands_and_ends_the_episode_without_success():
    environment = made("throw", reward="dense")
    action = holding(environment)
    environment.reset(0)
    action[-1] = 1
    step = environment.step(action)
    while not step.terminated:
        assert step.reward == 0
        step = environment.step(action)
    assert step.achieved_goal[2] == 1
    assert not step.success
    assert 0 < step.reward < 1


def test_a_cube_that_is_carried_to_the_floor_has_not_landed():
    environment = made("throw")
    task = environment.task
    environment.reset(0)
    x, y, _ = environment.robot.home
    task.cube.put_in_gripper(environment.robot, task.gripper, (x, y, 0.021))
    for _ in range(3):
        step = environment.step(holding(environment))
        if step.terminated:
            break
    down = environment.robot.towards((x, y, 0.0), 0.0)
    while not (step.terminated or step.truncated):
        step = environment.step(down)
    assert step.terminated
    assert step.achieved_goal[2] == -1
    assert not step.success
    assert step.reward == 0


@pytest.mark.parametrize("engine", ENGINES)
def test_a_hand_that_touches_the_floor_before_the_landing_has_failed(engine):
    environment = made("throw", environment={"engine": engine})
    task, robot = environment.task, environment.robot
    environment.reset(0)
    robot.place_tool((*robot.home[:2], 0.02), 1.0)
    task.cube.place((0.0, 0.8, 2.0))  # in the air, beside the arm
    down = robot.towards((*robot.home[:2], -0.1), 1.0)
    step = environment.step(down)
    while not step.terminated:
        step = environment.step(down)
    assert step.achieved_goal[2] == -1
    assert not step.success
    assert task.cube.position[2] > 0.1


def test_success_is_a_landing_after_a_release_and_its_distance_alone_and_a_dense_reward_is_higher_the_nearer():
    rule = made("throw", threshold=0.1).signature.goal_rule
    desired = np.zeros((5, 2), np.float32)
    achieved = np.array([[0, 0, 0], [0, 0, -1], [0, 0, 1], [0.09, 0, 1], [0, 0.11, 1]], np.float32)
    np.testing.assert_array_equal(rule.success(achieved, desired), [False, False, True, True, False])
    np.testing.assert_array_equal(rule.terminated(achieved, desired), [False, True, True, True, True])
    np.testing.assert_array_equal(rule.reward(achieved, desired), [0, 0, 1, 1, 0])
    np.testing.assert_allclose(rule.distance(achieved, desired), [np.inf, np.inf, 0, 0.09, 0.11], rtol=1e-6)
    far = np.array([[x, 0, 1] for x in (0, 0.1, 0.5, 2)], np.float32)
    rewards = made("throw", reward="dense").signature.goal_rule.reward(far, desired[:4])
    assert (np.diff(rewards) < 0).all()
    assert rewards[0] == 1
    assert rewards[-1] >= 0


def test_gravity_moves_the_landing_as_it_should():
    """Half the gravity: a dropped cube takes sqrt(2) as long, and the landing is still found."""

    def steps(gravity: float) -> int:
        environment = made("throw")
        environment.task.apply(environment.world, "gravity", gravity)
        environment.reset(0)
        action = holding(environment)
        action[-1] = 1
        count = 1
        while not environment.step(action).terminated:
            count += 1
        return count

    assert steps(-9.81) < steps(-4.9) < 1.8 * steps(-9.81)


@pytest.mark.parametrize("robot", ROBOTS)
def test_no_constant_throw_hits_often(robot):
    environment = made("throw", robot)
    targets = np.stack([environment.reset(seed).desired_goal for seed in range(300)])
    threshold = environment.task.settings.threshold
    away = np.hypot(*targets.T)
    distances, turns = np.linspace(away.min(), away.max(), 40), np.linspace(-0.52, 0.52, 21)
    landings = [(a * np.cos(turn), a * np.sin(turn)) for a in distances for turn in turns]
    hits = [(np.linalg.norm(targets - landing, axis=1) < threshold).mean() for landing in landings]
    assert max(hits) < 0.15


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_observation_says_where_and_when_a_flying_cube_lands(robot):
    environment = made("throw", robot)
    steps = expert_episode(environment, 3)
    field = environment.signature.observation.slice
    period = environment.robot.period
    flying = [step for step in steps[:-1] if np.linalg.norm(step.observation[field("object_from_tool")]) > 0.15]
    left = len(steps) - 1 - next(index for index, step in enumerate(steps) if step is flying[0])
    seen = flying[0].observation
    assert np.linalg.norm(seen[field("landing_if_released")] - steps[-1].achieved_goal[:2]) < 0.04
    assert seen[field("time_of_flight")][0] == pytest.approx(left * period, abs=2 * period)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("engine", ENGINES)
def test_an_episode_may_end_at_the_release_with_the_landing_that_follows(robot, engine):
    whole, short = (made("throw", robot, environment={"engine": engine}, end_at_release=at) for at in (0.0, 1.0))
    for seed in range(2):
        landed, released = expert_episode(whole, seed), expert_episode(short, seed)
        assert len(released) < len(landed)
        assert released[-1].terminated
        assert released[-1].achieved_goal[2] == 1
        assert np.linalg.norm(released[-1].achieved_goal[:2] - landed[-1].achieved_goal[:2]) < 0.001  # m
        for one, other in zip(released[:-1], landed, strict=False):
            np.testing.assert_array_equal(one.observation, other.observation)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("metres", [0.0, 0.05, 0.25])
def test_throws_start_as_far_from_home_as_the_setting_or_the_parameter_says(robot, metres):
    fixed = made("throw", robot, start_range=metres)
    drawn = made("throw", robot, draws={"task.start_range": values(metres)})
    starts = [[fixed.reset(seed) and fixed.robot.tool_position for seed in range(24)]]
    starts += [[drawn.reset(seed) and drawn.robot.tool_position for seed in range(24)]]
    np.testing.assert_array_equal(*starts)
    home, workspace = np.array(fixed.robot.home), fixed.robot.workspace
    low, high = np.maximum(home - metres, workspace.low), np.minimum(home + metres, workspace.high)
    assert (np.array(starts[0]) > low - 0.02).all()  # m; joints start with a small error
    assert (np.array(starts[0]) < high + 0.02).all()
    assert (np.ptp(starts[0], 0) >= 0.6 * (high - low)).all()


@pytest.mark.parametrize("height", [0.0, 0.3])
@pytest.mark.parametrize("rise", [-1.0, 0.0, 2.0])
def test_flight_time_solves_the_equation_of_free_fall(height, rise):
    seconds = flight_time(height, rise, -9.81)
    assert seconds >= 0
    if height:
        assert height + rise * seconds - 9.81 / 2 * seconds**2 == pytest.approx(0, abs=1e-9)
    assert flight_time(height, 0.0, 0.0) == (3.0 if height else 0.0)


def test_nearly_the_same_throw_lands_nearly_at_the_same_point():
    environment, generator, apart = made("throw", end_at_release=1.0), np.random.default_rng(0), []
    for seed in range(24):
        actions = generator.uniform(-1, 1, (4, 8)).repeat(3, 0)  # the arm accelerates until the release and after it
        actions[:, -1] = np.where(np.arange(12) < 7, -1, 1)
        landings = []
        for _ in range(5):
            environment.reset(seed)
            for count, action in enumerate(actions + 0.0005 * generator.standard_normal(actions.shape)):
                step = environment.step(action.astype(np.float32))
                if step.terminated:
                    landings.append((count, *step.achieved_goal))
                    break
        counts, *places, statuses = np.array(landings).T if landings else (np.zeros(0),) * 4
        if len(counts) == 5 and (statuses > 0).all() and np.ptp(counts) == 0:  # no hand touched the cube again
            apart.append(np.linalg.norm(np.std(places, axis=1)))
    assert len(apart) >= 12
    assert np.mean(apart) < 0.002  # m
