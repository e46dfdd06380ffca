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

MODES = ("joint", "cartesian", "pose", "impedance")
CASES = [*product(("panda", "ur5", "iiwa"), MODES), ("panda", "cartesian", "robot.yaw=true", "environment.substeps=20")]


def aimed(arm: Arm) -> Pose:
    """What actions move: the tool, or the set point of the spring that moves it."""
    control = arm._control
    return Pose.at(control._position, control._orientation) if hasattr(control, "_orientation") else arm.tool


@pytest.mark.parametrize("case", CASES, ids=" ".join)
def test_an_action_of_one_moves_the_robot_by_the_scale_of_the_export(case: tuple[str, ...]) -> None:
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
