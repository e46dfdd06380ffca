"""A robot that no task has heard of: every task works with it, and what robots promise is promised by it too."""

from dataclasses import replace

import numpy as np
import pytest
from support.fourth_robot import small_arm

from karolos.errors import PluginError, UsageError
from karolos.evaluation.playing import evaluate
from karolos.evaluation.policies import expert_policy
from karolos.plugins.contracts import Candidate, candidate, cases, robots
from karolos.plugins.contracts.joined import CONTROLS, goes_with, join, joined, reaching, refusal
from karolos.registry import load, names
from karolos.simulation.interface import Box

pytestmark = pytest.mark.xdist_group(__name__)

LAST_JOINT = '<joint name="joint6" type="revolute">'
LIGHT = '<mass value="0.1"/><inertia ixx="4e-5" iyy="4e-5" izz="8e-5"'
ENOUGH = {"pick_place": 0.9, "push": 0.9, "reach": 1.0}
"""Share of episodes that the expert solves at the least; any other task has to be solved once."""
TURNING = ("reach_pose", "reorient")
"""Tasks that need a robot which says where its tool can be turned."""


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Candidate:
    return Candidate("robots", "small", small_arm(tmp_path_factory.mktemp("urdf")))


def test_it_keeps_what_robots_promise(small):
    """Under the control modes of every robot; `.ci/run` checks the others with an arm of examples/."""
    for case in cases(small, alone=True):
        usual = case.candidates[0].settings["control"] in CONTROLS
        if usual and case.promise not in robots.GRIPPER:  # its grip of 15 N lifts the cube, and loses it in the shake
            case()


@pytest.mark.parametrize("task", names("tasks"))
@pytest.mark.parametrize("control", CONTROLS)
def test_every_task_is_solved_by_its_expert(small, task, control):
    if not goes_with(candidate("tasks", task), control):
        pytest.skip(f"{task} is not done in {control} control")
    robot = replace(small, settings={"control": control})
    if task in TURNING:
        assert "where this robot can turn its tool" in str(refusal(robot, candidate("tasks", task)))
        pytest.skip("it does not say where its tool can be turned")
    with joined(robot, candidate("tasks", task)) as made:
        found = evaluate(made, expert_policy(made), episodes=10, seed=0)
        assert made.divergences == 0
    assert found.success_end >= ENOUGH.get(task, 0.1)


def test_a_cube_lies_where_this_robot_works_and_as_its_gripper_is_held(small):
    made = join(small, candidate("tasks", "pick_place", start_grasped=0.5))
    box, yaw = made.robot.workspace, made.robot.home_yaw
    rotation = made.signature.observation.slice("object_rotation")
    for seed in range(10):
        step = made.reset(seed)
        assert box.contains(step.desired_goal.tolist(), 1e-6)
        assert box.contains(step.achieved_goal.tolist(), 1e-3)
        column = step.observation[rotation][:2]
        assert abs(np.sin(2 * (np.arctan2(column[1], column[0]) - yaw))) < 1e-5, "aligned but for quarter turns"
    made.close()


def test_a_robot_without_gripper_is_refused_where_one_is_needed_and_solves_the_rest(tmp_path):
    bare = Candidate("robots", "bare", small_arm(tmp_path, fingers=False))
    for task in names("tasks"):
        if task in (*TURNING, "slide"):  # see above; a puck rolls off a stick
            continue
        if load("tasks", task).uses_gripper:
            with pytest.raises(UsageError, match="Small: this robot has no gripper"):
                join(bare, candidate("tasks", task))
            continue
        with joined(bare, candidate("tasks", task)) as made:
            assert evaluate(made, expert_policy(made), episodes=5, seed=0).success_end >= 0.8, task


def test_a_light_wrist_with_the_damping_that_exporters_write_is_still(tmp_path):
    light = small_arm(tmp_path)
    path = light.model.urdf
    text = path.read_text().replace('<joint name="joint6" type="revolute">', f"{LAST_JOINT}<dynamics damping='1.0'/>")
    path.write_text(text.replace('<mass value="0.3"/><inertia ixx="0.0006" iyy="0.0006" izz="0.0006"', LIGHT))
    assert path.read_text().count(LIGHT) == 1
    with reaching(Candidate("robots", "light", light)) as made:
        made.reset(0)
        made.robot.apply("motor_gain", 0.8)
        made.reset(1)
        for _ in range(24):
            made.step(np.zeros(made.signature.action.size))
        assert max(map(abs, made.robot.joint_velocities)) < 0.05


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"workspace": Box((0.3, 0.28, 0.02), (0.6, 0.52, 0.3))}, r"at home the tool is at .* outside the workspace"),
        ({"fingers": {"joints": ("slide1", "slide3")}}, "no finger joint is called 'slide3'"),
        ({"fingers": {"links": ("pad1", "pad1")}}, "'slide2' does not move a link 'pad1'; it moves 'pad2'"),
        ({"fingers": None}, "nothing moves the prismatic joints slide1, slide2"),
    ],
)
def test_a_model_that_does_not_fit_its_urdf_is_refused_in_one_line(small, monkeypatch, changes, message):
    model = small.plugin.model
    fingers = changes.get("fingers", {})
    changes = {**changes, "fingers": replace(model.fingers, **fingers) if fingers is not None else None}
    monkeypatch.setattr(small.plugin, "model", replace(model, **changes))
    for use in (lambda: small.plugin(small.settled()), lambda: cases(small)):
        with pytest.raises(PluginError, match=message) as caught:
            use()
        assert "\n" not in str(caught.value)
