from itertools import pairwise
from math import dist

import numpy as np
import pytest
from support.closing import opened
from support.rig import ENGINES, part
from support.rig import made as made_of
from support.robots import ROBOTS

from karolos.environments.build import build_environment
from karolos.environments.robot_task import RobotTask
from karolos.environments.toy import Toy
from karolos.errors import PluginError, UsageError
from karolos.plugins.inspection import pair
from karolos.registry import names
from karolos.simulation.picture import view_of
from karolos.specification.parts import Part, Recipe
from karolos.tasks.push import Push


def environment(draws: dict[str, Part] | None = None, **arm: object) -> RobotTask:
    return made_of("reach", draws=draws, arm=arm)


def normal(mean: float, std: float) -> Part:
    return part("distributions", "normal", mean=mean, std=std)


def test_a_step_without_a_reset_or_a_proper_action_is_refused_and_the_episode_goes_on():
    made = environment()
    with pytest.raises(RuntimeError, match="reset"):
        made.step(np.zeros(3))
    made.reset(0)
    for action in (np.zeros(4), np.zeros((1, 3)), np.float32(0), np.zeros(0)):
        with pytest.raises(ValueError, match=r"PandaReach: an action has the shape \(3,\)"):
            made.step(action)
    for value in (np.nan, np.inf, -np.inf):
        with pytest.raises(ValueError, match="PandaReach: an action must be finite"):
            made.step(np.array([0.0, value, 0.0]))
        assert np.isfinite(made.step(np.zeros(3)).observation).all()


def test_actions_beyond_one_are_clipped():
    made = environment()
    made.reset(0)
    one = made.step(np.array([1.0, -1.0, 1.0])).observation
    made.reset(0)
    np.testing.assert_array_equal(made.step(np.array([7.0, -9.0, 1.5])).observation, one)


def test_observation_is_named_and_the_same_for_every_arm_in_cartesian_control():
    assert environment().signature.observation.names == ("tool_position", "tool_velocity")
    joint = environment(control="joint").signature
    assert joint.observation.names == ("tool_position", "tool_velocity", "joint_positions", "joint_velocities")
    assert joint.action.size == 7


def test_physics_blow_up_truncates_with_finite_numbers_and_the_next_episode_is_sound():
    made = environment()
    reference = made.reset(3)
    made.step(np.zeros(3))
    made.robot.motors.read = lambda: (np.full(7, np.nan), np.zeros(7), 0.0)  # type: ignore[attr-defined]
    step = made.step(np.zeros(3))
    assert step.truncated
    assert not step.terminated
    assert all(np.isfinite(part).all() for part in step)
    assert made.divergences == 1
    assert np.isnan(made.measures()).all()
    with pytest.raises(RuntimeError, match="over"):
        made.step(np.zeros(3))
    np.testing.assert_array_equal(made.reset(3).observation, reference.observation)
    assert not made.step(np.zeros(3)).truncated


@pytest.mark.parametrize("engine", ENGINES)
def test_measures_are_those_of_the_episode(engine):
    made = made_of("push", environment={"engine": engine})
    step, robot, expert = made.reset(3), made.robot, made.expert()
    expert.reset()
    made.world.forces(robot.body)  # PyBullet records all of them from the first question on
    tools, reached, forces, speeds = [robot.tool_position], [False], [], []
    while not step.truncated:
        step = made.step(expert.act())
        tools.append(robot.tool_position)
        reached.append(bool(step.success))
        forces += made.world.forces(robot.body).values()
        speeds += [abs(one) / most for one, most in zip(robot.joint_velocities, robot.limits.velocity, strict=True)]
    found = dict(zip([one.name for one in made.signature.measures], made.measures().tolist(), strict=True))
    assert found["path_length"] == pytest.approx(sum(dist(*pair) for pair in pairwise(tools)), rel=1e-5)
    assert found["peak_force"] == pytest.approx(max(forces), rel=1e-5)
    assert found["final_distance"] == pytest.approx(dist(step.achieved_goal, step.desired_goal), rel=1e-4)
    since = len(reached) - reached[::-1].index(False)
    assert found["time_to_success"] == pytest.approx(since / made.rate)
    assert max(speeds) <= found["peak_joint_speed"] * 1.00001 <= 1
    assert 0.1 < found["peak_joint_torque"] <= 1.001
    assert 0.1 < found["peak_joint_acceleration"] <= 1.05
    made.reset(3)
    made.step(np.zeros(3))
    assert made.measures()[2] < 0.1 * found["path_length"], "an episode begins with none"


def test_randomized_values_are_recorded_applied_and_follow_from_the_seed():
    drawn = {"task.gravity": normal(-9.81, 1.0), "robot.link_mass": part("distributions", "uniform", low=0.8, high=1.2)}
    made = environment(drawn)
    assert made.signature.parameters.names == ("robot.link_mass", "task.gravity")
    assert made.signature.parameters.fields[1].unit == "m/s2"

    def episode(seed: int) -> tuple[np.ndarray, np.ndarray]:
        made.reset(seed)
        drawn = made.parameters()
        for _ in range(5):
            step = made.step(np.array([0.5, -0.5, 0.5]))
        return drawn, step.observation

    first, second, again = episode(0), episode(1), episode(0)
    assert not np.array_equal(first[0], second[0])
    np.testing.assert_array_equal(first[0], again[0])
    np.testing.assert_array_equal(first[1], again[1])
    assert 0.8 <= first[0][0] <= 1.2
    with pytest.raises(UsageError, match=r"did you mean 'task.gravity'\?.*robot.link_mass"):
        environment({"task.gravty": normal(-9.81, 1)})


def test_a_recipe_has_a_robot_where_its_environment_takes_one():
    assert isinstance(build_environment(Recipe(part("environments", "toy"))), Toy)
    with pytest.raises(UsageError, match="no robot is given"):
        build_environment(Recipe(part("environments", "robot_task"), task=part("tasks", "reach")))
    with pytest.raises(UsageError, match="takes no robot"):
        build_environment(Recipe(part("environments", "toy"), part("robots", "panda")))


@pytest.mark.parametrize("task", names("tasks"))
@pytest.mark.parametrize("robot", ROBOTS)
def test_camera_shows_every_goal_and_the_robot(robot, task):
    made = opened(pair(robot, task))
    view = view_of(640, 480, made.task.camera)
    places = [made.robot.home]
    for seed in range(30):
        goal = made.reset(seed).desired_goal.tolist()
        if made.signature.desired_goal.fields[0].name in ("goal_position", "target"):
            places.append((*goal[:3], *[0.0] * (3 - len(goal))))
    right, up, ahead = view.axes @ (np.array(places, np.float32) - np.array(view.eye.origin)).T
    assert np.abs(right / ahead / view.edge * 480 / 640).max() < 0.9
    assert np.abs(up / ahead / view.edge).max() < 0.9


def throwing(*omit: str) -> RobotTask:
    return made_of("throw", "ur5", environment={"omit": omit})


def test_fields_are_left_out_of_the_observation():
    whole, made = throwing(), throwing("landing_if_released", "gripper_opening")
    fields = [field for field in whole.signature.observation.names if field not in made.settings.omit]
    assert made.signature.observation.names == tuple(fields)
    steps = [one.reset(3) for one in (whole, made)]
    for _ in range(3):
        for field in fields:
            columns = [one.signature.observation.slice(field) for one in (whole, made)]
            np.testing.assert_array_equal(steps[1].observation[columns[1]], steps[0].observation[columns[0]])
        assert steps[1].observation.shape == (made.signature.observation.size,)
        steps = [one.step(np.full(7, 0.3)) for one in (whole, made)]


def test_field_that_there_is_not_or_every_field_cannot_be_left_out():
    with pytest.raises(UsageError, match=r"environment\.omit: no observation is called landing; .*tool_position"):
        throwing("landing")
    with pytest.raises(UsageError, match=r"environment\.omit: nothing would be observed"):
        throwing(*throwing().signature.observation.names)


@pytest.mark.parametrize(("method", "name"), [("observe", "tip_velocity"), ("observe_for_critics", "peg_forces")])
def test_a_task_that_observes_what_is_not_finite_is_told_which(method, name, monkeypatch):
    made = made_of("insert", environment={"critic_observes": ("peg_forces",)})
    layout = made.task.observation if method == "observe" else made.task.critic_only
    values = np.zeros(layout.size)
    values[layout.slice(name)] = np.inf
    monkeypatch.setattr(made.task, method, values.tolist)
    with pytest.raises(PluginError, match=rf"^Insert: observes {name}, which is not finite"):
        made.reset(0)


@pytest.mark.parametrize(("declared", "given"), [((0.0, 0.0), -0.5), ((-0.2, 0.0), -0.5), ((-0.2, 0.0), np.nan)])
def test_a_task_whose_extra_reward_leaves_its_range_is_told_so(declared, given, monkeypatch):
    monkeypatch.setattr(Push, "extra_reward_range", declared)
    monkeypatch.setattr(Push, "extra_reward", lambda _: given)
    made = made_of("push")
    made.reset(0)
    with pytest.raises(PluginError, match=rf"^Push: extra_reward gives {given}, outside extra_reward_range"):
        made.step(np.zeros(made.signature.action.size, np.float32))
    monkeypatch.setattr(Push, "extra_reward", lambda _: declared[0])
    made.reset(0)
    assert made.step(np.zeros(made.signature.action.size, np.float32)).reward == np.float32(declared[0]) - 1


def test_a_task_may_observe_an_array(monkeypatch):
    made = made_of("push")
    expected = made.reset(0).observation
    observe = made.task.observe
    monkeypatch.setattr(made.task, "observe", lambda: np.array(observe()))
    np.testing.assert_array_equal(made.reset(0).observation, expected)


def test_physics_that_diverges_before_the_first_step_is_no_fault_of_the_task(monkeypatch):
    made = environment()
    monkeypatch.setattr(made.robot, "observe", lambda: [np.nan] * made.robot.observation.size)
    with pytest.raises(RuntimeError, match="the physics diverged before the first step"):
        made.reset(0)
