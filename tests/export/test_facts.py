"""What policy.json says of a robot is what the environment does when it is stepped."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from karolos.environments.build import used
from karolos.evaluation.policies import environment_of
from karolos.simulation.geometry import inverse, multiply, rotation_vector
from karolos.specification import load_spec

MODES = ("joint", "cartesian", "pose", "impedance")
CASES = [*product(("panda", "ur5", "iiwa"), MODES), ("panda", "cartesian", "robot.yaw=true", "environment.substeps=20")]


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
            for _ in range(8):
                joints, pose = np.array(arm.joint_positions), arm.tool
                environment.step(action)
            turn = rotation_vector(multiply(arm.tool.orientation, inverse(pose.orientation)))
            moved = {
                "joint_changes": np.array(arm.joint_positions) - joints,
                "tool_position_change": np.subtract(arm.tool.position, pose.position),
                "tool_turn": np.array(turn),
                "yaw_change": np.array(turn[2:]),
            }[field["name"]]
            assert moved[inside] == pytest.approx(field["scale"][inside] * action[place], rel=0.1), field
