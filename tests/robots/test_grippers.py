"""Arms with grippers that are not their own; what each combination promises is checked with the contracts."""

import re
from dataclasses import replace
from itertools import product
from xml.etree.ElementTree import Element

import numpy as np
import pytest
from support.fourth_robot import small_arm
from support.rig import ROBOTS
from support.spec_files import problems_of, write

from karolos.errors import PluginError, UsageError
from karolos.evaluation.playing import evaluate
from karolos.evaluation.policies import expert_policy
from karolos.plugins.contracts import candidate
from karolos.plugins.contracts.joined import join, joined, refusal
from karolos.plugins.contracts.robots import grasping
from karolos.registry import load, names
from karolos.robots.mounting import mounted
from karolos.robots.proposal import propose_gripper
from karolos.simulation import urdf


def mass(robot: Element) -> float:
    return sum(float(one.get("value", "nan")) for one in robot.iter("mass"))


@pytest.mark.parametrize("gripper", names("grippers"))
@pytest.mark.parametrize("robot", ROBOTS)
def test_a_mounted_gripper_adds_its_mass_and_moves_the_tool_along_the_approach(robot, gripper):
    plugin, part = load("robots", robot), load("grippers", gripper).model
    own, other = (plugin(plugin.Settings(gripper=name)) for name in (None, gripper))
    assert mass(other.model.description.robot) == pytest.approx(mass(urdf.read(plugin.model.urdf)) + part.mass)
    longer = part.tool[2] - load("grippers", plugin.model.gripper).model.tool[2]
    np.testing.assert_allclose(other.home, np.subtract(own.home, (0, 0, longer)), atol=1e-3)
    if gripper == plugin.model.gripper:
        assert other.model == own.model
        assert other.workspace == plugin.model.workspace


def test_what_cannot_be_mounted_is_refused_in_one_line(tmp_path):
    with pytest.raises(UsageError, match="cannot take the gripper franka_hand"):
        mounted(small_arm(tmp_path).model, "franka_hand")
    model = load("robots", "ur5").model
    with pytest.raises(UsageError, match=r"franka_hand weighs 0.76 kg, more than the payload of 0.5 kg"):
        mounted(replace(model, payload=0.5), "franka_hand")
    with pytest.raises(PluginError, match="no link 'nowhere' to mount a gripper on"):
        _ = mounted(replace(model, flange=replace(model.flange, link="nowhere")), "robotiq_2f85").description
    cup = candidate("robots", "ur5", gripper="vacuum")
    refused = [task for task in names("tasks") if refusal(cup, candidate("tasks", task))]
    assert refused == ["insert", "reach_pose", "reorient", "slide", "throw"]
    with pytest.raises(UsageError, match=r"robot.gripper: .*PyBullet|bullet"):
        join(candidate("robots", "ur5", "bullet", gripper="vacuum"), candidate("tasks", "pick_place"))


@pytest.mark.parametrize(("robot", "task"), [*product(ROBOTS, ["pick_place"]), ("ur5", "stack")])
def test_experts_pick_and_stack_with_a_suction_cup(robot, task):
    with joined(candidate("robots", robot, gripper="vacuum"), candidate("tasks", task)) as environment:
        found = evaluate(environment, expert_policy(environment), episodes=2, seed=0)
    assert found.success_end == 1


@pytest.mark.parametrize(("share", "held"), [(0.9, True), (1.1, False)])
def test_friction_at_the_lip_of_a_cup_holds_what_hangs_beside_it(share, held):
    with grasping(candidate("robots", "ur5", gripper="vacuum", control="joint")) as environment:
        environment.reset(0)
        robot, cube = environment.robot, environment.task.cube
        mass = share * 0.5 * robot.gripper.max_force / 9.81  # the cube's coefficient is .5, that of the lip 1
        cube.set_inertia(mass, (mass * 0.04**2 / 6,) * 3)
        x, y, z = robot.workspace.centre
        robot.place_tool((x, y, z + 0.1), 0.0, orientation=(0.0, 0.5**0.5, 0.0, 0.5**0.5), closing=True)
        cube.place((x + 0.02, y, z + 0.1))
        for _ in range(24):
            environment.step(np.array([0.0] * 6 + [-1.0]))
        assert (robot.pads_touching(cube) == 2) == held


def test_a_gripper_whose_base_points_into_the_arm_is_refused_and_the_advice_helps(tmp_path):
    upright, path = urdf.text_of(load("grippers", "franka_hand").model.urdf), tmp_path / "hand.urdf"
    path.write_text(upright)
    numbers, _ = propose_gripper(path)
    [base] = set(re.findall(r'<link name="([^"]+)"', upright)) - set(re.findall(r'<child link="([^"]+)"', upright))
    turned = upright.replace(
        "</robot>", f'<joint name="turn" type="fixed"><parent link="base_"/><child link="{base}"/>'
    )
    turned += '<origin xyz="0 0 0" rpy="{} 0 0"/></joint><link name="base_"/></robot>'
    path.write_text(turned.format(np.pi))
    with pytest.raises(PluginError, match="they are not ahead of it along z; put a link with z away from the arm"):
        propose_gripper(path)
    path.write_text(turned.format(0))
    assert propose_gripper(path)[0]["tool"] == numbers["tool"]


def test_an_unknown_gripper_is_told_at_its_place_with_the_closest_name(tmp_path):
    text = "robot: {name: ur5, gripper: franka_hnd}\ntask: reach\nagent: sac\n"
    (line,) = problems_of(write(tmp_path, "s.yaml", text))
    expected = "s.yaml:1:29: robot.gripper: no gripper is called 'franka_hnd'; did you mean 'franka_hand'?"
    assert line.startswith(expected)
