"""An arm with its gripper: where it stands, how it moves, the floor below it, when it releases what it holds."""

from collections.abc import Sequence

import numpy as np
import pytest
from support.rig import ENGINES, ROBOTS, expert_episode, made

from karolos.core import Array
from karolos.environments.robot_task import RobotTask
from karolos.errors import PluginError


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_middle_of_the_workspace_is_above_the_origin(robot):
    centred, plain = (made("reach", robot, arm={"base": base}).robot for base in ("centred", "origin"))
    assert plain.base == (0.0, 0.0, 0.0)
    assert centred.workspace.centre[:2] == pytest.approx((0, 0), abs=1e-12)
    assert centred.workspace.low[2] == plain.workspace.low[2]
    np.testing.assert_allclose(np.subtract(centred.home, plain.home), centred.base, atol=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("task", ["reach", "pick_place", "throw"])
def test_an_episode_is_that_of_an_arm_at_the_origin_moved(task, engine):
    centred, plain = (
        made(task, "ur5", environment={"engine": engine}, arm={"base": base}) for base in ("centred", "origin")
    )
    base, layout = centred.robot.base, plain.signature.observation
    positions = [layout.slice(name) for name in ("tool_position", "object_position") if name in layout.names]
    steps, expected = expert_episode(centred, 0), expert_episode(plain, 0)
    assert len(steps) == len(expected)
    assert steps[-1].success
    assert expected[-1].success
    goals = zip(steps[0].desired_goal, expected[0].desired_goal, base, strict=False)
    assert all(a == pytest.approx(b + by, abs=1e-6) for a, b, by in goals)
    for a, b in zip(steps[:3], expected[:3], strict=True):
        for columns in positions:
            np.testing.assert_allclose(a.observation[columns], b.observation[columns] + base, atol=1e-3)
    np.testing.assert_allclose(np.subtract(centred.camera.target, plain.camera.target), base)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("robot", ROBOTS)
def test_full_joint_actions_bring_no_link_deep_into_the_floor(robot, engine):
    environment = made("reach", robot, environment={"engine": engine}, arm={"control": "joint"})
    arm, depth = environment.robot, 0.0
    for seed in range(10):
        draws = np.random.default_rng(seed)
        step, world = environment.reset(seed), environment.world
        while not step.truncated:
            step = environment.step(draws.choice([-1.0, 1.0], environment.signature.action.size))
            for link in arm.body.links().values():
                depth = max([depth, *(-contact.distance for contact in world.contacts(arm.body, world.floor, link))])
    assert 0.0 < depth < 0.005


@pytest.mark.parametrize("control", ["joint", "cartesian"])
def test_gripper_opens_and_closes_and_its_fingers_agree(control):
    environment = made("pick_place", arm={"control": control}, max_steps=1000)
    environment.reset(0)
    where = environment.signature.observation.slice("gripper_opening")
    action = np.zeros(environment.signature.action.size)
    for wish, opening in ((-1.0, 0.0), (1.0, 1.0), (0.0, 0.5)):
        action[-1] = wish
        for _ in range(30):
            step = environment.step(action)
        assert step.observation[where] == pytest.approx(opening, abs=0.03)
        first, second = environment.robot.body.joints([7, 8])
        assert abs(first[0] - second[0]) < 1e-3


def test_yaw_turns_the_gripper_and_is_seen():
    environment = made("reach", arm={"yaw": True})
    start = environment.reset(0)
    heading = environment.signature.observation.slice("tool_heading")
    for _ in range(10):
        step = environment.step(np.array([0.0, 0.0, 0.0, 0.5]))
    before, after = (np.arctan2(*s.observation[heading][::-1]) for s in (start, step))
    assert after - before > 0.4
    assert np.linalg.norm(step.achieved_goal - start.achieved_goal) < 0.01


def test_tool_that_cannot_be_placed_is_a_clear_error():
    environment = made("reach")
    environment.reset(0)
    with pytest.raises(PluginError, match="workspace"):
        environment.robot.place_tool((1.5, 0.0, 0.2), 0.0)


def test_delayed_action_takes_effect_later():
    environment = made("reach")
    started = environment.reset(0).observation[:3]
    environment.robot.apply("action_delay", 2.0)
    environment.reset(0)
    push = np.array([1.0, 0.0, 0.0])
    moved = [float(np.linalg.norm(environment.step(push).observation[:3] - started)) for _ in range(5)]
    assert max(moved[:2]) < 0.002
    assert moved[4] > 0.01


def test_noise_is_on_the_observation_and_not_on_the_goal():
    environment = made("reach")
    environment.reset(0)
    environment.robot.apply("observation_noise", 0.05)
    step = environment.reset(0)
    assert np.abs(step.observation[:3] - step.achieved_goal).max() > 0.001
    again = environment.reset(0)
    np.testing.assert_array_equal(step.observation, again.observation)


def throwing(engine: str, *, timed: bool = True, delay: float = 0.0) -> RobotTask:
    arm = {"timed_release": timed, "gripper_delay": delay}
    return made("throw", "ur5", environment={"engine": engine}, arm=arm, end_at_release=1.0)


def swing(environment: RobotTask, commands: Sequence[float]) -> Array:
    """Where the cube lands (2,) when the arm swings and the gripper is told that, one command a step, closed before."""
    environment.reset(0)
    for command in [-1.0] * 4 + [*commands] + [1.0] * 10:
        action = np.zeros(environment.signature.action.size, np.float32)
        action[0], action[-1] = 1.0, command
        step = environment.step(action)
        if step.terminated:
            return step.achieved_goal[:2]
    raise AssertionError("nothing was thrown")


def along(place: Array, early: Array, late: Array) -> float:
    """The share of the way between two landings, a control step apart, at which a third one lies."""
    step = late - early
    return float((place - early) @ step / (step @ step))


@pytest.mark.parametrize("engine", ENGINES)
def test_the_gripper_opens_later_in_the_step_the_less_it_is_told_to_open(engine):
    environment = throwing(engine)
    environment.reset(0)
    held = 2 * environment.robot.opening - 1
    early, late = swing(environment, [1.0]), swing(environment, [-1.0, 1.0])
    assert np.linalg.norm(late - early) > 0.05, "the swing is so fast that a step matters"  # m
    shares = (0.85, 0.65, 0.45, 0.25, 0.05)  # a control step has 10 physics steps
    landed = [swing(environment, [held + share * (1 - held)]) for share in shares]
    found = [along(place, early, late) for place in landed]
    assert found == pytest.approx([0.1, 0.3, 0.5, 0.7, 0.9], abs=0.05)
    again = swing(environment, [held + shares[0] * (1 - held)])
    assert np.array_equal(again, landed[0]), "the release of the episode before is forgotten"


@pytest.mark.parametrize("engine", ENGINES)
def test_a_delayed_gripper_opens_that_much_later_across_control_steps_and_else_at_the_beginning(engine):
    prompt = throwing(engine, timed=False)
    early, late = swing(prompt, [1.0]), swing(prompt, [-1.0, 1.0])
    assert swing(prompt, [0.3]) == pytest.approx(early, abs=1e-3)
    for later in (0.3, 1.3):
        delayed = throwing(engine, timed=False, delay=later / 24)
        assert along(swing(delayed, [1.0]), early, late) == pytest.approx(later, abs=0.1)
    delayed.robot.apply("gripper_delay", 0.0)  # as randomization does
    assert np.array_equal(swing(delayed, [1.0]), early)
