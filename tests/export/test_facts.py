"""What policy.json says of a robot is what the environment does when it is stepped."""

from contextlib import AbstractContextManager
from itertools import product
from typing import Any

import numpy as np
import pytest

from karolos.environments.build import used
from karolos.evaluation.policies import environment_of
from karolos.robots.arm import Arm
from karolos.simulation.geometry import inverse, multiply, rotation_vector
from karolos.simulation.kinematics import Pose
from karolos.specification import load_spec

ARMS = ("panda", "ur5", "iiwa")
MODES = ("joint", "cartesian", "pose", "impedance")
CASES = [*product(ARMS, MODES), ("panda", "cartesian", "robot.yaw=true", "environment.substeps=20")]


def aimed(arm: Arm) -> Pose:
    """What actions move: the tool, or the set point of the spring that moves it."""
    control = arm._control
    return Pose.at(control._position, control._orientation) if hasattr(control, "_orientation") else arm.tool


@pytest.mark.parametrize("case", CASES, ids=" ".join)
def test_an_action_of_one_moves_the_robot_by_the_scale_of_the_export(case):
    robot, control, *others = case
    given = [f"robot={robot}", f"robot.control={control}", "robot.reset_noise=0", "task.threshold=0.001", *others]
    with used(environment_of(load_spec("panda_reach", given))) as environment:
        arm = environment.robot
        facts = arm.facts()
        assert facts["rate"] == pytest.approx(1 / environment.world.period)
        assert facts["control"] == control
        places = [(field, inside) for field in facts["action"] for inside in range(field["size"])]
        for place, (field, inside) in enumerate(places):
            environment.reset(0)
            action = np.zeros(len(places), np.float32)
            action[place] = 0.999 if place % 2 else -0.999
            farthest = 0.0
            for _ in range(8):  # from rest to steady motion, and perhaps to a limit
                joints, pose = np.array(arm.joint_positions), aimed(arm)
                environment.step(action)
                turn = rotation_vector(multiply(aimed(arm).orientation, inverse(pose.orientation)))
                moved = {
                    "joint_changes": np.array(arm.joint_positions) - joints,
                    "tool_position_change": np.subtract(aimed(arm).position, pose.position),
                    "tool_turn": np.array(turn),
                    "yaw_change": np.array(turn[2:]),
                }[field["name"]]
                farthest = max(farthest, moved[inside] / action[place])
            bounds = (0.9, 1.1) if field["name"] == "yaw_change" else (0.6, 1.25)  # limits are near
            assert bounds[0] < farthest / field["scale"][inside] < bounds[1], (field, farthest)


def stepped(case: list[str], name: str = "panda_reach") -> AbstractContextManager[Any]:
    given = ["robot.reset_noise=0", "task.max_steps=2000", *case]
    return used(environment_of(load_spec(name, given)))


@pytest.mark.parametrize("robot", ARMS)
def test_joints_keep_the_limits_and_speeds_of_the_export_and_reach_them(robot):
    with stepped([f"robot={robot}", "robot.control=joint", "robot.joint_step=0.5"]) as environment:
        arm = environment.robot
        joints = arm.facts()["joints"]
        for sign, bound in ((1, "upper"), (-1, "lower")):
            environment.reset(0)
            assert arm.joint_positions == pytest.approx([joint["home"] for joint in joints], abs=1e-9)
            action = np.zeros(len(joints), np.float32)
            action[-1] = sign  # the last joint turns freely
            speeds, last = [], joints[-1]
            for _ in range(200):
                environment.step(action)
                speeds.append(abs(arm.joint_velocities[-1]))
            assert arm.joint_positions[-1] == pytest.approx(last[bound], abs=2e-3)
            assert 0.95 < max(speeds) / last["velocity"] < 1.01


@pytest.mark.parametrize("robot", ARMS)
def test_actions_lead_to_the_faces_of_the_workspace_of_the_export_and_no_farther(robot):
    with stepped([f"robot={robot}", "robot.control=cartesian", "robot.base=centred"]) as environment:
        arm = environment.robot
        facts = arm.facts()
        for axis, side in product(range(3), (0, 1)):
            environment.reset(0)
            action = np.zeros(3, np.float32)
            action[axis] = 2 * side - 1
            for _ in range(150):
                environment.step(action)
            assert arm.tool_position[axis] == pytest.approx(facts["workspace"][side][axis], abs=3e-3)
    with stepped([f"robot={robot}", "robot.control=cartesian"]) as environment:
        environment.reset(0)
        other = environment.robot
        expected = np.subtract(arm.home, facts["base"])
        assert other.tool_position == pytest.approx(expected + other.facts()["base"], abs=1e-6)


@pytest.mark.parametrize("robot", ARMS)
def test_the_gripper_of_the_export_opens_as_wide_as_it_says(robot):
    with stepped([f"robot={robot}", "robot.control=cartesian"], "panda_pick") as environment:
        arm, apart = environment.robot, {}
        told = arm.facts()["gripper"]
        environment.reset(0)
        for name in ("closed", "open"):
            for _ in range(60):
                environment.step(np.array([0, 0, 1, told[name]], np.float32))
            first, second = (np.array(arm.body.link(link).centre) for link in arm.motors.pads)
            apart[name] = (first - second)[1]  # the fingers close along y, each moves by half
        assert abs(apart["open"] - apart["closed"]) == pytest.approx(told["width"], abs=2e-3)


def test_the_spring_of_the_export_presses_with_its_stiffness_times_its_error():
    given = ["robot.control=impedance", "robot.error_limit=0.02"]
    with stepped(given, "panda_push") as environment:
        arm = environment.robot
        spring = arm.facts()["spring"]
        environment.reset(0)
        cube = environment.task.cube
        x, y, z = cube.position
        arm.place_tool((x, y, z + 0.06), 0.0, closing=True)
        farthest = 0.0
        for _ in range(60):
            environment.step(np.array([0, 0, -1, 0, 0, 0], np.float32))
            farthest = max(farthest, float(np.linalg.norm(np.subtract(arm._control._position, arm.tool_position))))
        assert farthest == pytest.approx(spring["error_limit"], rel=0.05)
        error = arm.tool_position[2] - arm._control._position[2]
        assert arm.contact_force(cube.body) == pytest.approx(spring["stiffness"] * error, rel=0.1)
