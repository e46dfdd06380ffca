"""Promises of every robot: its motion under each control mode, and the grip of its gripper."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from ...core import Array, FloatArray
from ...environments.robot_task import RobotTask
from ...randomization.randomization import RandomizedParameter
from ...simulation.interface import Body
from ...tasks.reach import Reach
from .case import Candidate, demand, demand_same
from .joined import joined, reaching

SPEED_TOLERANCE = 1.05
"""Largest measured speed of a joint by its limit; the solver exceeds the limit slightly."""


def an_episode_begins_and_takes_a_step(one: Candidate) -> None:
    """The robot can be built, begins an episode of reach and takes a step."""
    with reaching(one) as environment:
        environment.reset(0)
        environment.step(np.zeros(environment.signature.action.size))


def no_joint_exceeds_its_speed_under_full_actions(one: Candidate) -> None:
    """Full actions in changing directions bring no joint above its speed or out of its range."""
    with reaching(one) as environment:
        limits = environment.robot.limits
        speeds = np.array(limits.velocity)
        draws = _generator()
        environment.reset(0)
        fastest = np.zeros(len(speeds))
        action = np.ones(environment.signature.action.size)
        for step in range(300):
            if step % 5 == 0 or step > 150:  # first held, then every step
                action = np.sign(draws.uniform(-1, 1, action.size))
            environment.step(action)
            joints = _body(environment).joints(range(len(speeds)))
            fastest = np.maximum(fastest, [abs(state[1]) for state in joints])
            positions = np.array([state[0] for state in joints])
            inside = (positions > np.array(limits.lower) - 0.02) & (positions < np.array(limits.upper) + 0.02)
            demand(inside.all(), f"joint {limits.name(int(np.argmin(inside)))} leaves its range")
        worst = int(np.argmax(fastest / speeds))
        demand(
            (fastest <= SPEED_TOLERANCE * speeds).all(),
            f"joint {limits.name(worst)} reaches {fastest[worst]:.3g} rad/s, its limit is {speeds[worst]:.3g}",
        )
        demand((fastest > 0.5 * speeds).any(), "full actions bring no joint to half its speed")


def the_tool_reaches_every_corner_of_the_workspace(one: Candidate) -> None:
    """The tool comes within 5 mm of every corner and of the centre of every edge and face of the workspace."""
    with reaching(one) as environment:
        robot = environment.robot
        box = robot.workspace
        for fractions in product((0.0, 0.5, 1.0), repeat=3):
            x, y, z = (
                low + (high - low) * fraction for low, high, fraction in zip(box.low, box.high, fractions, strict=True)
            )
            environment.reset(0)
            for _ in range(45):
                environment.step(robot.towards((x, y, z), 0.0))
            distance = float(np.linalg.norm(np.subtract(robot.tool_position, (x, y, z))))
            demand(distance < 0.005, f"the tool stays {1000 * distance:.1f} mm away from {x:.3f} {y:.3f} {z:.3f}")


def an_arm_at_rest_stays_where_it_is(one: Candidate) -> None:
    """Zero actions for 2 s move the tool by less than 2 mm."""
    with reaching(one) as environment:
        before = environment.reset(1).achieved_goal
        for _ in range(48):
            step = environment.step(np.zeros(environment.signature.action.size))
        moved = float(np.linalg.norm(step.achieved_goal - before))
        demand(moved < 0.002, f"zero actions move the tool by {1000 * moved:.1f} mm")


def the_state_of_the_tool_is_that_of_the_physics(one: Candidate) -> None:
    """The tool's position and velocity by kinematics agree with the simulated last link."""
    with reaching(one) as environment:
        robot: Any = environment.robot
        draws = _generator()
        environment.reset(2)
        for _ in range(10):
            before = np.array(robot.tool_position)
            environment.step(draws.uniform(-1, 1, environment.signature.action.size))
            speed = float(np.linalg.norm((np.array(robot.tool_position) - before) * 24))
            demand(speed < 3, f"the tool moves at {speed:.2f} m/s, faster than 3 m/s")
            state = _body(environment).link(len(robot.limits.lower) - 1, moved=True)
            offset = np.linalg.norm(np.array(robot.tool_position) - state.position)
            length = np.linalg.norm(robot.model.tool)
            demand(
                abs(offset - length) < 1e-6, f"the tool is {offset:.6f} m from the last link instead of {length:.6f}"
            )
            arm = np.array(robot.tool_position) - state.centre
            velocity = np.array(state.velocity) + np.cross(state.angular_velocity, arm)
            near = np.allclose(robot.tool_velocity, velocity, atol=1e-5)
            demand(near, f"the tool's velocity is {robot.tool_velocity}, by its link {velocity}")


def home_is_in_the_workspace_and_the_tool_points_down(one: Candidate) -> None:
    """At home the tool is in the workspace and points down."""
    with reaching(one) as environment:
        robot = environment.robot
        demand(robot.workspace.contains(robot.home), f"home, {robot.home}, is outside the workspace")
        pose: Any = robot.forward(robot.home_joints).tool
        demand(np.allclose(pose.z, (0, 0, -1), atol=1e-3), f"at home the tool points to {pose.z} instead of down")


def the_tool_can_be_placed_at_a_reset(one: Candidate) -> None:
    """`place_tool` puts the tool within 1 mm of a position."""
    with reaching(one) as environment:
        environment.reset(0)
        robot = environment.robot
        robot.place_tool(robot.workspace.centre, 1.0)
        distance = float(np.linalg.norm(np.subtract(robot.tool_position, robot.workspace.centre)))
        demand(distance < 0.001, f"the tool is {1000 * distance:.1f} mm away from the position of place_tool")


def the_arm_is_still_at_both_ends_of_each_parameter(one: Candidate) -> None:
    """At both ends of each parameter of the arm zero actions for 2 s move the tool by less than 2 mm."""
    with reaching(one) as environment:
        robot = environment.robot
        still = np.zeros(environment.signature.action.size)
        environment.reset(0)  # builds the world, without which no parameter can be set
        for name, declared, value in _ends_of_the_arm(environment):
            robot.apply(name, value)
            start = environment.reset(1).achieved_goal
            for _ in range(48):
                step = environment.step(still)
            robot.apply(name, declared.nominal)
            moved = float(np.linalg.norm(step.achieved_goal - start))
            demand(moved < 0.002, f"with {name} = {value:g} zero actions move the tool by {1000 * moved:.1f} mm")
            fastest = max(map(abs, robot.joint_velocities))
            demand(fastest < 0.05, f"with {name} = {value:g} a joint moves at {fastest:.2f} rad/s at zero actions")


def each_parameter_acts_and_can_be_reset(one: Candidate) -> None:
    """Each parameter of the arm changes the motion or the torques, and its nominal value restores both."""
    with reaching(one) as environment:
        robot = environment.robot

        def end() -> tuple[FloatArray, Array]:
            draws = _generator()
            environment.reset(0)
            for _ in range(10):
                step = environment.step(draws.uniform(-1, 1, environment.signature.action.size))
            return step.observation, _torques(environment)

        observation, torques = end()
        for name, declared, value in _ends_of_the_arm(environment):
            if value == declared.nominal or name == "joint_friction":
                continue
            robot.apply(name, value)
            changed, other = end()
            robot.apply(name, declared.nominal)
            # motors compensate masses: they change the motion where a motor is short of torque
            acts = np.abs(changed - observation).max() > 1e-5 or np.abs(other - torques).max() > 1e-2
            demand(acts, f"{name} = {value:g} changes neither motion nor torques")
            demand_same(end()[0], observation, f"observations before and after a change of {name}")


def dry_friction_takes_its_fraction_of_the_largest_torques(one: Candidate) -> None:
    """Full actions never take more torque than `joint_friction` leaves to a motor, and take all of it without it."""
    with reaching(one) as environment:
        robot = environment.robot
        most = np.array(robot.limits.effort)
        shares = []
        environment.reset(0)  # builds the world
        for fraction in (0.0, robot.parameters["joint_friction"].high):
            robot.apply("joint_friction", fraction)
            draws = _generator()
            environment.reset(0)
            taken = np.zeros(len(most))
            for step in range(150):
                if step % 15 == 0:  # long enough to be stopped by the floor or the end of a joint
                    action = np.sign(draws.uniform(-1, 1, environment.signature.action.size))
                environment.step(action)
                taken = np.maximum(taken, np.abs(_torques(environment)))
            demand(
                (taken <= 1.01 * (1 - fraction) * most).all(),
                f"with joint_friction = {fraction:g} motors take {taken.round(1)} N m",
            )
            shares.append(float((taken / most).max()))
        demand(shares[0] > 1.02 * shares[1], "joint_friction changes no torque")


def every_joint_reaches_its_speed(one: Candidate) -> None:
    """In joint control each joint reaches between .9 and 1.05 of its speed, also with the largest joint_damping."""
    with reaching(one) as environment:
        robot = environment.robot
        environment.reset(0)  # builds the world
        for damping, (joint, speed) in product(
            (0.0, robot.parameters["joint_damping"].high), enumerate(robot.limits.velocity)
        ):
            robot.apply("joint_damping", damping)
            fastest = 0.0
            for direction in (-1.0, 1.0):  # one direction may be short, or lead into the floor
                environment.reset(0)
                action = np.zeros(environment.signature.action.size)
                action[joint] = direction
                for _ in range(12):
                    environment.step(action)
                    fastest = max(fastest, direction * robot.joint_velocities[joint])
            demand(
                0.9 * speed < fastest < SPEED_TOLERANCE * speed,
                f"joint {robot.limits.name(joint)} reaches {fastest:.3g} rad/s with joint_damping = {damping:g}, "
                f"its limit is {speed:.3g}",
            )


def a_full_action_moves_the_tool_by_one_tool_step(one: Candidate) -> None:
    """In steady motion from home a full action moves the tool by `tool_step` within 10 %, and it points down."""
    with reaching(replace(one, settings={**one.settings, "reset_noise": 0.0})) as environment:
        robot: Any = environment.robot
        for axis, direction in product(range(3), (-1.0, 1.0)):
            environment.reset(0)
            action = np.zeros(environment.signature.action.size)
            action[axis] = direction
            places = [robot.tool_position]
            for _ in range(3):
                environment.step(action)
                places.append(robot.tool_position)
                tilt = np.degrees(np.arccos(min(1.0, -robot.forward(robot.joint_positions).tool.z[2])))
                demand(tilt < 5, f"the tool tilts by {tilt:.1f} degrees")
            step = direction * (places[3][axis] - places[1][axis]) / 2  # the arm accelerates in the first step
            demand(
                abs(step / robot.tool_step - 1) < 0.1,
                f"a full action along {'-+'[direction > 0]}{'xyz'[axis]} moves the tool by {1000 * step:.1f} mm, "
                f"tool_step is {1000 * robot.tool_step:.1f} mm",
            )


def a_pressed_cube_stays_on_the_floor(one: Candidate) -> None:
    """A cube of 4 cm, pressed for 2 s, sinks less than 5 mm into the floor and is not shot away.

    Its speed exceeds that of the tool by less than a tenth and .2 m/s. It is pressed in the middle, and near an edge
    at another place.
    """
    with reaching(one) as environment:
        robot = environment.robot
        environment.reset(0)
        cube = environment.world.box((0.04, 0.04, 0.04), 0.1, (0.9, 0.4, 0.1, 1.0))
        for aside, off_x, off_y in ((0.0, 0.0, 0.0), (0.12, 0.012, 0.008)):
            environment.reset(0)
            x, y, _ = robot.workspace.centre
            cube.place((x, y + aside, 0.02))
            deepest = fastest = 0.0
            speeds = [0.0] * 4  # the cube follows a tool that brakes
            for step in range(78):
                environment.step(robot.towards((x + off_x, y + aside + off_y, 0.12 if step < 30 else 0.0), 0.0))
                speeds = [*speeds[1:], float(np.linalg.norm(robot.tool_velocity))]
                fastest = max(fastest, float(np.linalg.norm(cube.velocity()[0])) - 1.1 * max(speeds))
                (_, _, height), (i, j, k, w) = cube.pose()
                upright = abs(2 * (i * k - w * j)) + abs(2 * (j * k + w * i)) + abs(1 - 2 * (i * i + j * j))
                deepest = max(deepest, 0.02 * upright - height)
            demand(deepest < 0.005, f"a pressed cube is {1000 * deepest:.1f} mm deep in the floor")
            demand(fastest < 0.2, f"a pressed cube is {fastest:.2f} m/s faster than 1.1 times the tool")


def accelerations_are_those_of_the_data_sheet(one: Candidate) -> None:
    """With `acceleration: sheet` no joint changes its speed by more than the data sheet's acceleration and a tenth."""
    if getattr(one.plugin, "model", None) is None or one.plugin.model.accelerations is None:
        return
    with reaching(replace(one, settings={**one.settings, "acceleration": "sheet"})) as environment:
        robot = environment.robot
        largest = np.array(one.plugin.model.accelerations)
        draws = _generator()
        measured = np.zeros(len(largest))
        for seed in range(6):
            environment.reset(seed)
            before = np.zeros(len(largest))
            for step in range(8):  # before the arm meets the floor
                if step % 4 == 0:
                    action = np.sign(draws.uniform(-1, 1, environment.signature.action.size))
                environment.step(action)
                speeds = np.array(robot.joint_velocities)
                measured = np.maximum(measured, np.abs(speeds - before) / robot.period)
                before = speeds
        worst = int(np.argmax(measured / largest))
        demand(
            (measured < 1.1 * largest).all(),
            f"joint {robot.limits.name(worst)} accelerates with {measured[worst]:.1f} rad/s2, "
            f"its sheet says {largest[worst]:.1f}",
        )


class Grasping(Reach):
    """Reach with a gripper that opens and closes."""

    uses_gripper = True


def a_gripped_cube_is_held_through_a_shake_alike_in_a_fresh_and_a_used_world(one: Candidate) -> None:
    """A cube of 4 cm and .1 kg is held through a shake of 1 s, bit for bit alike in a fresh and a used world."""
    with _grasping(one) as used, _grasping(one) as fresh:
        poses = _held_through_a_shake(used, 0.1)
        demand_same(_held_through_a_shake(used, 0.1), poses, "the cube's poses in a world that was used before")
        demand_same(_held_through_a_shake(fresh, 0.1), poses, "the cube's poses in a fresh world")


def a_heavy_cube_is_held_through_a_shake(one: Candidate) -> None:
    """A cube of 4 cm and .3 kg is held through a shake of 1 s."""
    with _grasping(one) as environment:
        _held_through_a_shake(environment, 0.3)


def each_pad_presses_with_the_force_of_the_gripper(one: Candidate) -> None:
    """Each pad presses a gripped cube with the declared force within 5 %."""
    with _grasping(one) as environment:
        cube = _lifted_cube(environment, 0.1)
        robot: Any = environment.robot
        forces = []
        for _ in range(12):
            environment.step(np.array([0.0, 0.0, 0.0, -1.0]))
            forces.append(
                [
                    sum(contact.force for contact in environment.world.contacts(robot.body, cube, pad))
                    for pad in _pads(robot)
                ]
            )
        declared, measured = robot.gripper.force, np.mean(forces, 0)
        near = np.abs(measured / declared - 1) < 0.05
        demand(near.all(), f"the pads press with {measured.round(1)} N, the gripper declares {declared:g} N")


ANY_ROBOT: tuple[Callable[[Candidate], None], ...] = (
    the_tool_reaches_every_corner_of_the_workspace,
    an_arm_at_rest_stays_where_it_is,
    home_is_in_the_workspace_and_the_tool_points_down,
    the_tool_can_be_placed_at_a_reset,
    the_arm_is_still_at_both_ends_of_each_parameter,
)
"""Promises that need the public protocol `Robot` alone."""
ARM: tuple[Callable[[Candidate], None], ...] = (
    no_joint_exceeds_its_speed_under_full_actions,
    the_state_of_the_tool_is_that_of_the_physics,
    each_parameter_acts_and_can_be_reset,
)
"""Promises of every `robots.arm.Arm` under each control mode. They look at its motors and its body."""
JOINT_CONTROL: tuple[Callable[[Candidate], None], ...] = (
    every_joint_reaches_its_speed,
    dry_friction_takes_its_fraction_of_the_largest_torques,
    accelerations_are_those_of_the_data_sheet,
)
CARTESIAN_CONTROL: tuple[Callable[[Candidate], None], ...] = (
    a_full_action_moves_the_tool_by_one_tool_step,
    a_pressed_cube_stays_on_the_floor,
)
GRIPPER = (
    a_gripped_cube_is_held_through_a_shake_alike_in_a_fresh_and_a_used_world,
    a_heavy_cube_is_held_through_a_shake,
    each_pad_presses_with_the_force_of_the_gripper,
)


def _generator() -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(0))


def _body(environment: RobotTask) -> Any:
    """The arm's simulated body, which tasks do not see."""
    return environment.robot.body  # type: ignore[attr-defined]


def _pads(robot: Any) -> list[int]:
    """The links of the gripper's pads in the arm's simulated body."""
    links = robot.body.links()
    return [links[name] for name in robot.model.fingers.links]


def _torques(environment: RobotTask) -> Array:
    """Of the arm's motors in N m: (n,)."""
    states = _body(environment).joints(range(len(environment.robot.limits.effort)))
    return np.array([state[3] for state in states])


def _ends_of_the_arm(environment: RobotTask) -> Iterator[tuple[str, RandomizedParameter, float]]:
    """Name, declaration and value of the lower and of the upper end of each parameter of the arm's dynamics."""
    for name, declared in environment.robot.parameters.items():
        if name.startswith(("joint_", "link_", "motor_")):  # those of grip and observation are checked in `pairs`
            for value in (declared.low, declared.high):
                yield name, declared, value


def _grasping(one: Candidate) -> AbstractContextManager[RobotTask]:
    return joined(one, Candidate("tasks", "grasping", Grasping), max_steps=1000)


def _lifted_cube(environment: RobotTask, mass: float, poses: list[Array] | None = None) -> Body:
    """Grip a cube of 4 cm and this mass in kg and lift it. Its poses (7,) after each step are added to `poses`."""
    environment.reset(0)
    robot: Any = environment.robot
    if not hasattr(environment, "cube"):
        environment.cube = environment.world.box((0.04, 0.04, 0.04), mass, (0.9, 0.4, 0.1, 1.0))  # type: ignore[attr-defined]
    cube: Body = environment.cube  # type: ignore[attr-defined]
    x, y, _ = robot.workspace.centre
    cube.place((x, y, 0.02))
    top = min(0.3, robot.workspace.high[2])
    for height, opening, count in ((0.02, 1.0, 40), (0.02, 0.0, 20), (top, 0.0, 30)):
        for _ in range(count):
            environment.step(robot.towards((x, y, height), opening))
            if poses is not None:
                poses.append(np.concatenate(cube.pose()))
    demand(robot.pads_touching(cube) == 2, "the cube slips out while it is lifted")
    return cube


def _held_through_a_shake(environment: RobotTask, mass: float) -> Array:
    """Grip a cube of this mass in kg, lift and shake it. Returns its poses (steps, 7)."""
    poses: list[Array] = []
    cube = _lifted_cube(environment, mass, poses)
    robot: Any = environment.robot

    def position_in_gripper() -> Array:
        tool = robot.forward(robot.joint_positions).tool
        position: Array = np.array([tool.x, tool.y, tool.z]) @ np.subtract(cube.pose()[0], tool.position)
        return position

    start, apart = position_in_gripper(), 0.0
    for shake in range(24):
        environment.step(np.array([0.0, 1.0 if shake % 2 else -1.0, 1.0 if shake % 4 < 2 else -1.0, -1.0]))
        poses.append(np.concatenate(cube.pose()))
        first, second = robot.body.joints(_pads(robot))
        apart = max(apart, abs(first[0] - second[0]))
    creep = float(np.linalg.norm(position_in_gripper() - start))
    demand(creep < 0.002, f"a cube of {mass:g} kg creeps {1000 * creep:.1f} mm in the gripper")
    demand(apart < 0.001, f"the positions of the fingers differ by {1000 * apart:.1f} mm")
    return np.array(poses)
