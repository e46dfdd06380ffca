"""What policy.json says of a robot is what the environment does when it is stepped."""

from itertools import product

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


@pytest.mark.parametrize("robot", ARMS)
def test_actions_lead_to_the_faces_of_the_workspace_of_the_export_and_no_farther(robot):
    given = [f"robot={robot}", "robot.control=cartesian", "robot.base=centred", "robot.reset_noise=0"]
    with used(environment_of(load_spec("panda_reach", [*given, "task.max_steps=2000"]))) as environment:
        arm = environment.robot
        facts = arm.facts()
        for axis, side in product(range(3), (0, 1)):
            environment.reset(0)
            action = np.zeros(3, np.float32)
            action[axis] = 2 * side - 1
            for _ in range(150):
                environment.step(action)
            assert arm.tool_position[axis] == pytest.approx(facts["workspace"][side][axis], abs=3e-3)


@pytest.mark.parametrize("robot", ARMS)
def test_the_export_has_the_numbers_of_the_arm_that_the_contracts_of_robots_check(robot):
    given = [f"robot={robot}", "robot.control=impedance", "robot.error_limit=0.02"]
    with used(environment_of(load_spec("panda_pick", given))) as environment:
        environment.reset(0)
        arm = environment.robot
        facts, limits, home = arm.facts(), arm.limits, arm.forward([one["home"] for one in arm.facts()["joints"]])
        for key, values in (("lower", limits.lower), ("upper", limits.upper), ("velocity", limits.velocity)):
            assert [joint[key] for joint in facts["joints"]] == list(values)
        assert home.tool.position == pytest.approx(arm.home, abs=1e-6)
        assert facts["gripper"]["width"] == arm.gripper.width
        spring = facts["spring"]
        assert (spring["stiffness"], spring["error_limit"]) == (arm.settings.stiffness, 0.02)
