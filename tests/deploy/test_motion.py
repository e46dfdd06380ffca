"""Kinematics and control modes of karolos-deploy are those of karolos."""

from itertools import product
from typing import Any

import numpy as np
import pytest
from karolos_deploy.kinematics import Chain, Orientations, chain_of, turn_of, turned_by
from karolos_deploy.motion import Motion

from karolos.environments.build import used
from karolos.evaluation.policies import environment_of
from karolos.export.bundle import arm_of, describe_robot
from karolos.simulation.geometry import matrix_of, nearest, quaternion_of, rotation_about, rotation_vector
from karolos.simulation.kinematics import Pose
from karolos.specification import load_spec

ARMS = ("panda", "ur5", "iiwa")


def environment(robot: str, mode: str) -> Any:
    given = [f"robot={robot}", f"robot.control={mode}", "robot.reset_noise=0", "robot.base=centred"]
    return used(environment_of(load_spec("panda_reach", given)))


def test_rotation_vectors_are_those_of_karolos():
    generator = np.random.default_rng(0)
    for angle in (0.0, 1e-12, 1e-7, 0.3, 3.0, np.pi - 1e-7, np.pi):
        axis = generator.normal(size=3)
        vector = angle * axis / np.linalg.norm(axis)
        np.testing.assert_allclose(turned_by(vector), matrix_of(rotation_about(vector)), atol=1e-12)
        found = turn_of(turned_by(vector))
        assert min(np.linalg.norm(found - vector), np.linalg.norm(found + vector) + (angle < 3.1)) < 1e-6
        np.testing.assert_allclose(np.abs(found), np.abs(rotation_vector(quaternion_of(turned_by(vector)))), atol=1e-6)


def test_the_nearest_orientation_is_that_of_karolos():
    generator = np.random.default_rng(1)
    for _ in range(200):
        middle = quaternion_of(turned_by(generator.normal(size=3)))
        own = Orientations(matrix_of(middle), 0.3, 0.8)
        asked = turned_by(generator.normal(size=3) * 0.7) @ matrix_of(middle)
        np.testing.assert_allclose(
            own.nearest(asked), matrix_of(nearest(middle, 0.3, 0.8, quaternion_of(asked))), atol=1e-6
        )


@pytest.mark.parametrize("robot", ARMS)
def test_the_chain_of_the_contract_is_that_of_the_arm(robot):
    with environment(robot, "cartesian") as world:
        arm = arm_of(world)
        chain: Chain = chain_of(describe_robot(world, robot))
        generator = np.random.default_rng(2)
        for _ in range(20):
            joints, rates = generator.normal(size=(2, chain.size))
            known, at = arm.forward(joints.tolist()), chain.at(joints)
            np.testing.assert_allclose(at.position, known.tool.position, atol=1e-12)
            np.testing.assert_allclose(at.rotation.T, known.tool[1:], atol=1e-12)
            np.testing.assert_allclose(at.jacobian @ rates, arm.chain.jacobian(known) @ rates, atol=1e-12)
            place, turn = at.position + 0.02 * generator.normal(size=3), turned_by(0.1 * generator.normal(size=3))
            target = Pose(tuple(place), *map(tuple, (turn @ at.rotation).T))
            expected = arm.chain.step(known, target, (0.1 * rates).tolist())
            np.testing.assert_allclose(chain.step(at, place, turn @ at.rotation, 0.1 * rates), expected, atol=1e-9)


@pytest.mark.parametrize("case", [*product(ARMS, ("joint", "cartesian", "pose", "impedance"))], ids=" ".join)
def test_set_points_lead_where_the_same_actions_lead_in_training(case):
    robot, mode = case
    with environment(robot, mode) as world:
        world.reset(0)
        arm, contract = arm_of(world), describe_robot(world, robot)
        chain = chain_of(contract)
        motion, cycle = Motion(contract, chain), arm.period / 20
        motion.reset(np.array(arm.joint_positions), chain.at(arm.joint_positions))
        generator = np.random.default_rng(3)
        action, farthest = generator.uniform(-1, 1, arm.action.size), 0.0
        for step in range(8):  # then some arm meets the floor
            if step % 4 == 0:
                action = generator.uniform(-1, 1, arm.action.size)
            positions = np.array(arm.joint_positions)
            motion.plan(action, positions, chain.at(positions), step * arm.period)
            for inside in range(20):
                point = motion.at(step * arm.period + inside * cycle, cycle)
            world.step(action.astype(np.float32))
            if mode == "impedance":
                control: Any = arm._control
                np.testing.assert_allclose(point.place, control._position, atol=1e-6)
                np.testing.assert_allclose(point.rotation, matrix_of(control._orientation), atol=1e-6)
                continue
            farthest = max(farthest, float(np.abs(motion.positions - arm.joint_positions).max()))
        assert farthest < 0.006, "rad; the set points keep a limit of jerk that training does not have"


def test_set_points_keep_the_limits_of_speed_acceleration_and_jerk():
    with environment("panda", "joint") as world:
        world.reset(0)
        contract = describe_robot(world, "panda")
        motion, cycle, generator = Motion(contract, chain_of(contract)), 0.002, np.random.default_rng(4)
        positions = np.array([joint["home"] for joint in contract["joints"]])
        motion.reset(positions, motion.chain.at(positions))
        told = [motion.positions]
        for count in range(2000):
            now = count * cycle
            if count % 21 == 0:
                motion.plan(np.sign(generator.normal(size=7)), motion.positions, motion.chain.at(motion.positions), now)
            motion.at(now, cycle)
            told.append(motion.positions)
        speed = np.diff(told, axis=0) / cycle
        acceleration = np.diff(speed, axis=0) / cycle
        jerk = np.diff(acceleration, axis=0) / cycle
        assert (np.abs(speed).max(0) <= motion.speed * 1.001).all()
        assert (np.abs(acceleration).max(0) <= motion.acceleration * 1.001).all()
        assert (np.abs(jerk).max(0) <= motion.acceleration / 0.004 * 1.001).all()
        assert (np.array(told) >= motion.lower).all()
        assert (np.array(told) <= motion.upper).all()
