"""Promises of every robot: its motion under each control mode, and the grip of its gripper."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import replace
from itertools import permutations, product
from math import cos, inf, sin
from typing import Any

import numpy as np

from ...core import Array, FloatArray, random_actions
from ...core.parameters import RandomizedParameter
from ...core.seeding import Generator
from ...environments.robot_task import RobotTask
from ...robots.settings import ArmSettings
from ...simulation.geometry import inverse, multiply, rotated, rotation_vector
from ...simulation.interface import Body, Cup, Gripper, World
from ...simulation.shapes import Cuboid
from ...tasks.reach import Reach
from .case import Candidate, Promises, candidate, demand, demand_same
from .environments import an_episode_begins_and_takes_a_step
from .joined import joined, reaching

SPEED_TOLERANCE = 1.05
"""Largest measured speed of a joint by its limit; the solver exceeds the limit slightly."""
TOOL_TOLERANCE = 1.02
"""Largest measured speed of the tool by its limit."""

SIZE = 0.04
"""Edge in m of the cube that is pressed and gripped."""


class Grasping(Reach):
    """Reach with a gripper that opens and closes, and with a cube in the gripper (below a cup) at the start."""

    uses_gripper = True  # type: ignore[assignment]  # mypy narrows the union to the literal of Reach

    def build(self, world: World) -> None:
        super().build(world)
        self.cube = world.body([Cuboid((SIZE, SIZE, SIZE))], 0.1, (0.9, 0.4, 0.1, 1.0))

    def reset(self, generator: Generator) -> None:
        super().reset(generator)
        robot, (x, y, z) = self._robot, self._robot.workspace.centre
        width = robot.gripper.width if isinstance(robot.gripper, Gripper) else inf
        robot.place_tool((x, y, z), SIZE / width, closing=True)
        self.cube.place((x, y, z - _rise(robot)), (0.0, 0.0, sin(robot.home_yaw / 2), cos(robot.home_yaw / 2)))


def grasping(one: Candidate) -> AbstractContextManager[RobotTask]:
    return joined(one, Candidate("tasks", "grasping", Grasping), max_steps=1000)


def as_its_sheet_says(one: Candidate) -> AbstractContextManager[RobotTask]:
    return reaching(replace(one, settings={**one.settings, "acceleration": "sheet"}))


def in_physics_steps(one: Candidate) -> AbstractContextManager[RobotTask]:
    """The robot with the task reach. A control step is one physics step, so that each one can be inspected."""
    return joined(one, candidate("tasks", "reach"), substeps=1, max_steps=100_000)


BEGINS = Promises(reaching, basic=True)
BEGINS(an_episode_begins_and_takes_a_step)
ANY_ROBOT = Promises(reaching)
"""Promises that need only the public protocol `Robot`."""
ARM = Promises(reaching)
"""Promises of every `robots.arm.Arm` under each control mode. They inspect its motors and its body."""
JOINT_CONTROL, CARTESIAN_CONTROL, IMPEDANCE_CONTROL = Promises(reaching), Promises(reaching), Promises(reaching)
TURNED = Promises(reaching)
"""Promises of pose and impedance control of an arm that says where it can turn its tool."""
LIMITS = Promises(in_physics_steps)
"""Promises of an arm's joint control that hold in each physics step."""
SHEET = Promises(as_its_sheet_says)
"""Promises of an arm whose maker publishes accelerations."""
GRIPPER, FINGERS, CUP = Promises(grasping), Promises(grasping), Promises(grasping)


@ARM
def no_joint_leaves_its_range_under_full_actions(environment: RobotTask) -> None:
    """Full actions in changing directions bring no joint out of its range, and some joint to half its speed."""
    robot, limits = environment.robot, environment.robot.limits
    lower, upper, speeds = (np.array(values) for values in (limits.lower, limits.upper, limits.velocity))
    environment.reset(0)
    fastest = np.zeros(len(speeds))
    for action in (*_full_actions(environment, 150, held=5), *_full_actions(environment, 150, held=1)):
        environment.step(action)
        fastest, positions = np.maximum(fastest, np.abs(robot.joint_velocities)), np.array(robot.joint_positions)
        inside = (positions > lower - 0.02) & (positions < upper + 0.02)
        demand(inside.all(), f"joint {limits.name(int(np.argmin(inside)))} leaves its range")
    demand((fastest > 0.5 * speeds).any(), "full actions bring no joint to half its speed")


@ANY_ROBOT
def the_tool_reaches_every_corner_of_the_workspace(environment: RobotTask) -> None:
    """The tool comes within 5 mm of every corner and of the centre of every edge and face of the workspace."""
    robot = environment.robot
    box = robot.workspace
    steps = 150 if "impedance" in robot.engine_needs.values() else 45  # springs are slower
    slower = max(1.0, ArmSettings.model_fields["tool_step"].default / robot.tool_step)  # so are slow joints
    for x, y, z in product(*zip(box.low, box.centre, box.high, strict=True)):
        environment.reset(0)
        near = 0
        for _ in range(round(steps * slower)):
            environment.step(robot.towards((x, y, z), 0.0))
            distance = float(np.linalg.norm(np.subtract(robot.tool_position, (x, y, z))))
            near = near + 1 if distance < 0.005 else 0
            if near == 5:  # it stays there
                break
        demand(near, f"the tool stays {1000 * distance:.1f} mm away from {x:.3f} {y:.3f} {z:.3f}")


@ANY_ROBOT
def an_arm_at_rest_stays_where_it_is(environment: RobotTask) -> None:
    """Zero actions for 2 s move the tool by less than 2 mm."""
    moved = _creep(environment)
    demand(moved < 0.002, f"zero actions move the tool by {1000 * moved:.1f} mm")


@ARM
def the_state_of_the_tool_is_that_of_the_physics(environment: RobotTask) -> None:
    """The tool's position and velocity by kinematics agree with the simulated last link."""
    robot: Any = environment.robot
    environment.reset(2)
    for action in random_actions(environment.signature, 10, _generator()):
        before = np.array(robot.tool_position)
        environment.step(action)
        speed = float(np.linalg.norm((np.array(robot.tool_position) - before) * 24))
        demand(speed < 3, f"the tool moves at {speed:.2f} m/s, faster than 3 m/s")
        state = robot.body.link(len(robot.limits.lower) - 1)
        offset = np.linalg.norm(np.array(robot.tool_position) - state.position)
        length = np.linalg.norm(robot.model.tool)
        demand(abs(offset - length) < 1e-6, f"the tool is {offset:.6f} m from the last link instead of {length:.6f}")
        arm = np.array(robot.tool_position) - state.centre
        velocity = np.array(state.velocity) + np.cross(state.angular_velocity, arm)
        near = np.allclose(robot.tool_velocity, velocity, atol=1e-5)
        demand(near, f"the tool's velocity is {robot.tool_velocity}, by its link {velocity}")


@ANY_ROBOT
def home_is_in_the_workspace_and_the_tool_points_down(environment: RobotTask) -> None:
    """At home the tool is in the workspace and points down."""
    robot = environment.robot
    demand(robot.workspace.contains(robot.home), f"home, {robot.home}, is outside the workspace")
    pose: Any = robot.forward(robot.home_joints).tool
    demand(np.allclose(pose.z, (0, 0, -1), atol=1e-3), f"at home the tool points to {pose.z} instead of down")


@ANY_ROBOT
def the_tool_can_be_placed_at_a_reset(environment: RobotTask) -> None:
    """`place_tool` puts the tool within 1 mm of a position."""
    environment.reset(0)
    robot = environment.robot
    robot.place_tool(robot.workspace.centre, 1.0)
    distance = float(np.linalg.norm(np.subtract(robot.tool_position, robot.workspace.centre)))
    demand(distance < 0.001, f"the tool is {1000 * distance:.1f} mm away from the position of place_tool")


@ANY_ROBOT
def the_arm_is_still_at_both_ends_of_each_parameter(environment: RobotTask) -> None:
    """At both ends of each parameter of the arm zero actions for 2 s move the tool by less than 2 mm."""
    robot = environment.robot
    environment.reset(0)  # builds the world, without which no parameter can be set
    for name, declared, value in _ends_of_the_arm(environment):
        robot.apply(name, value)
        moved = _creep(environment)
        robot.apply(name, declared.nominal)
        demand(moved < 0.002, f"with {name} = {value:g} zero actions move the tool by {1000 * moved:.1f} mm")
        fastest = max(map(abs, robot.joint_velocities))
        demand(fastest < 0.05, f"with {name} = {value:g} a joint moves at {fastest:.2f} rad/s at zero actions")


@ARM
def each_parameter_acts_and_can_be_reset(environment: RobotTask) -> None:
    """Each parameter of the arm changes the motion or the torques, and its nominal value restores both."""
    robot = environment.robot

    def end() -> tuple[FloatArray, Array]:
        environment.reset(0)
        for action in random_actions(environment.signature, 10, _generator()):
            step = environment.step(action)
        return step.observation, np.array(robot.joint_torques)

    observation, torques = end()
    for name, declared, value in _ends_of_the_arm(environment):
        if value == declared.nominal or name == "joint_friction":
            continue
        robot.apply(name, value)
        changed, other = end()
        robot.apply(name, declared.nominal)
        # motors compensate masses: these change the motion if a motor lacks torque
        acts = np.abs(changed - observation).max() > 1e-5 or np.abs(other - torques).max() > 1e-2
        demand(acts, f"{name} = {value:g} changes neither motion nor torques")
        demand_same(end()[0], observation, f"observations before and after a change of {name}")


@JOINT_CONTROL
def dry_friction_takes_its_fraction_of_the_largest_torques(environment: RobotTask) -> None:
    """Full actions use at most the torque that `joint_friction` leaves to a motor, and without friction all of it."""
    robot = environment.robot
    most = np.array(robot.limits.effort)
    shares = []
    environment.reset(0)  # builds the world
    for fraction in (0.0, robot.parameters["joint_friction"].high):
        robot.apply("joint_friction", fraction)
        environment.reset(0)
        taken = np.zeros(len(most))
        for action in _full_actions(environment, 150, held=15):  # stopped by the floor or the end of a joint
            environment.step(action)
            taken = np.maximum(taken, np.abs(robot.joint_torques))
        kept = (taken <= 1.01 * (1 - fraction) * most).all()
        demand(kept, f"with joint_friction = {fraction:g} motors take {taken.round(1)} N m")
        shares.append(float((taken / most).max()))
    demand(shares[0] > 1.02 * shares[1], "joint_friction changes no torque")


@JOINT_CONTROL
def every_joint_reaches_its_speed(environment: RobotTask) -> None:
    """In joint control each joint reaches between .9 and 1.05 of its speed, also with the largest joint_damping.

    A joint may be slower if the tool reaches .9 of its own speed.
    """
    robot = environment.robot
    environment.reset(0)  # builds the world
    dampings = 0.0, robot.parameters["joint_damping"].high
    for damping, (joint, speed) in product(dampings, enumerate(robot.limits.velocity)):
        robot.apply("joint_damping", damping)
        fastest = tool = 0.0
        for direction in (-1.0, 1.0):  # one direction may be short, or lead into the floor
            environment.reset(0)
            for _ in range(12):
                environment.step(_along(environment, joint, direction))
                fastest = max(fastest, direction * robot.joint_velocities[joint])
                tool = max(tool, float(np.linalg.norm(robot.tool_velocity)))
        found = f"{fastest:.3g} rad/s with joint_damping = {damping:g}, its limit is {speed:.3g}"
        kept = 0.9 * speed < fastest or tool > 0.9 * robot.tool_speed
        kept &= fastest < SPEED_TOLERANCE * speed
        demand(kept, f"joint {robot.limits.name(joint)} reaches {found}")


@CARTESIAN_CONTROL
def a_full_action_moves_the_tool_by_one_tool_step(environment: RobotTask) -> None:
    """In steady motion past home a full action moves the tool by `tool_step` within 10 %, and it points down."""
    robot: Any = environment.robot
    robot.reset_noise = 0.0
    for axis, direction in product(range(3), (-1.0, 1.0)):
        environment.reset(0)
        before = [at - 3 * robot.tool_step * direction * (place == axis) for place, at in enumerate(robot.home)]
        robot.place_tool(tuple(before), 0.0)
        places = [robot.tool_position]
        for _ in range(6):
            environment.step(_along(environment, axis, direction))
            places.append(robot.tool_position)
            tilt = np.degrees(np.arccos(min(1.0, -robot.forward(robot.joint_positions).tool.z[2])))
            demand(tilt < 5, f"the tool tilts by {tilt:.1f} degrees")
        step = direction * (places[6][axis] - places[4][axis]) / 2  # the arm accelerates in the first steps
        found = f"{1000 * step:.1f} mm, tool_step is {1000 * robot.tool_step:.1f} mm"
        where = f"{'-+'[direction > 0]}{'xyz'[axis]}"
        demand(abs(step / robot.tool_step - 1) < 0.1, f"a full action along {where} moves the tool by {found}")


@CARTESIAN_CONTROL
def a_motion_keeps_its_direction_beside_one_to_and_fro(environment: RobotTask) -> None:
    """.3 of an action along one axis moves the tool by .6 to 1.1 of it, while full actions alternate along another."""
    robot: Any = environment.robot
    for axis, other in permutations(range(3), 2):
        environment.reset(0)
        robot.place_tool(robot.workspace.centre, 0.0)
        start, full = robot.tool_position[axis], _along(environment, other, 1.0)
        for step in range(10):
            environment.step(0.3 * _along(environment, axis, 1.0) + (-1) ** step * full)
        share = (robot.tool_position[axis] - start) / (10 * 0.3 * robot.tool_step)
        where = f"{'xyz'[axis]} with {'xyz'[other]} to and fro"
        demand(0.6 < share < 1.1, f"along {where} the tool moves {share:.2f} of what the actions say")


@TURNED
def each_of_100_poses_is_reached(environment: RobotTask) -> None:
    """The tool comes within 5 mm and .02 rad of 100 poses in `dexterous`, tilted up to the arm's limit."""
    robot: Any = environment.robot
    draws, orientations, box = _generator(), robot.orientations, robot.dexterous
    environment.reset(0)
    for _ in range(100):
        position, direction = tuple(draws.uniform(box.low, box.high).tolist()), draws.uniform(-np.pi, np.pi)
        tilt, turn = orientations.tilt, draws.uniform(-orientations.turn, orientations.turn)
        goal = orientations.at(tilt * cos(direction), tilt * sin(direction), turn)
        for _ in range(150):
            environment.step(robot.towards(position, 0.0, goal))
            distance = float(np.linalg.norm(np.subtract(robot.tool_position, position)))
            angle = float(np.linalg.norm(rotation_vector(multiply(goal, inverse(robot.tool.orientation)))))
            if distance < 0.005 and angle < 0.02:
                break
        found = f"{1000 * distance:.1f} mm and {angle:.3f} rad away from {np.round(position, 3)} m, turned by {goal}"
        demand(distance < 0.005 and angle < 0.02, f"the tool stays {found}")


@IMPEDANCE_CONTROL
def a_spring_presses_as_its_stiffness_and_its_limit_say(environment: RobotTask) -> None:
    """Against a wall at each side the wrench at the wrist is stiffness times error within 5 %, up to the limit."""
    robot: Any = environment.robot
    environment.reset(0)
    wall = environment.world.body([Cuboid((0.1, 0.1, 0.1))], 0.0, (0.6, 0.6, 0.6, 1.0))
    settings, where = robot.settings, environment.signature.observation.slice("set_point")
    stiffness = np.repeat([settings.stiffness, settings.turn_stiffness], 3)
    most = settings.stiffness * settings.error_limit
    for axis, side in ((0, -1.0), (0, 1.0), (1, -1.0), (1, 1.0), (2, -1.0)):
        environment.reset(0)
        start = robot.workspace.centre
        robot.place_tool(start, 0.0)
        aside = [0.0, 0.0, -0.045] if axis < 2 else [0.045, 0.045, 0.0]  # it meets an edge, which turns the tool, too
        # set points stay in the workspace
        room = robot.workspace.high[axis] - start[axis] - settings.error_limit - 0.005
        aside[axis] = (0.05 + min(0.1, room)) * side
        wall.place(tuple(np.add(start, aside).tolist()))
        felt, pulled = np.zeros(6), np.zeros(6)
        for step in range(120):
            observation = environment.step(_along(environment, axis, side) * (step < 60)).observation
            if step >= 96:
                turn = np.transpose([robot.tool.x, robot.tool.y, robot.tool.z])
                felt += np.concatenate((turn @ robot.wrench[:3], turn @ robot.wrench[3:])) / 24
                pulled += stiffness * observation[where] / 24
        off, size = (np.linalg.norm(one.reshape(2, 3), axis=1) for one in (felt + pulled, pulled))
        found = f"feels {felt.round(2)}, stiffness times error is {pulled.round(2)} (N, N m)"
        demand((off < 0.05 * size + [0.1, 0.01]).all(), f"pressing along {axis}, the wrist {found}")
        force = float(np.linalg.norm(felt[:3]))
        demand(0.9 * most < force < 1.01 * most, f"a wall is pressed with {force:.1f} N, the limit is {most:.1f} N")


@CARTESIAN_CONTROL
def a_pressed_cube_stays_on_the_floor(environment: RobotTask) -> None:
    """A cube of 4 cm, pressed for 2 s, sinks less than 5 mm into the floor and is not shot away.

    Its speed exceeds that of the tool by less than a tenth and .2 m/s. It is pressed in the middle, and near an edge
    at another place.
    """
    robot = environment.robot
    environment.reset(0)
    cube = environment.world.body([Cuboid((SIZE, SIZE, SIZE))], 0.1, (0.9, 0.4, 0.1, 1.0))
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


@LIMITS
def joints_and_tool_keep_their_speeds_in_every_physics_step(environment: RobotTask) -> None:
    """Full actions bring no joint beyond 1.05 and the tool not beyond 1.02 of its speed until something is touched."""
    robot: Any = environment.robot
    speeds, fastest, tool = np.array(robot.limits.velocity), np.zeros(len(robot.limits.velocity)), 0.0
    environment.reset(0)
    for number, action in enumerate(_full_actions(environment, 1200, held=40)):
        environment.step(action)
        if environment.world.forces(robot.body):
            environment.reset(number)
            continue
        fastest = np.maximum(fastest, np.abs(robot.joint_velocities))
        tool = max(tool, float(np.linalg.norm(robot.tool_velocity)))
    joint = int(np.argmax(fastest / speeds))
    found = f"{fastest[joint]:.3g} rad/s, its limit is {speeds[joint]:.3g}"
    demand(fastest[joint] <= SPEED_TOLERANCE * speeds[joint], f"joint {robot.limits.name(joint)} reaches {found}")
    demand(tool <= TOOL_TOLERANCE * robot.tool_speed, f"the tool moves at {tool:.2f} of {robot.tool_speed:.2f} m/s")


@SHEET
def accelerations_are_those_of_the_data_sheet(environment: RobotTask) -> None:
    """Motors change no joint's speed by more than the sheet's acceleration and a tenth, until something is touched."""
    robot: Any = environment.robot
    largest = np.array(robot.model.accelerations)
    measured, touched = np.zeros(len(largest)), True
    for number, action in enumerate(_full_actions(environment, 240, held=4)):
        if touched or number % 8 == 0:
            environment.reset(number)
            before = np.zeros(len(largest))
        environment.step(action)
        touched = bool(environment.world.forces(robot.body))  # the floor stops an arm faster than its motors
        if touched:
            continue
        speeds = np.array(robot.joint_velocities)
        measured, before = np.maximum(measured, np.abs(speeds - before) / robot.period), speeds
    joint = int(np.argmax(measured / largest))
    found = f"{measured[joint]:.1f} rad/s2, its sheet says {largest[joint]:.1f}"
    demand(measured[joint] < 1.1 * largest[joint], f"joint {robot.limits.name(joint)} accelerates with {found}")


@GRIPPER
def a_gripped_cube_is_held_through_a_shake_alike_in_a_fresh_and_a_used_world(environment: RobotTask) -> None:
    """A cube of 4 cm and .1 kg is held through a shake of 1 s, bit for bit the same in a new and in a used world."""
    poses = _held_through_a_shake(environment, 0.1)
    demand_same(_held_through_a_shake(environment, 0.1), poses, "the cube's poses in a world that was used before")
    environment.close()
    demand_same(_held_through_a_shake(environment, 0.1), poses, "the cube's poses in a fresh world")


@GRIPPER
def an_object_that_is_held_at_a_reset_moves_alike_in_a_fresh_and_a_used_world(environment: RobotTask) -> None:
    """An episode that begins with a cube in the gripper repeats bit for bit, independent of earlier episodes."""

    def held() -> Array:
        environment.reset(0)
        poses = []
        for action in random_actions(environment.signature, 10, _generator()):
            environment.step(np.append(action[:-1], -1.0))
            poses.append(np.concatenate(environment.task.cube.pose()))  # type: ignore[attr-defined]
        return np.array(poses)

    first = held()
    demand_same(held(), first, "the cube's poses in a world that was used before")
    environment.close()
    demand_same(held(), first, "the cube's poses in a fresh world")


@GRIPPER
def a_heavy_cube_is_held_through_a_shake(environment: RobotTask) -> None:
    """A cube of 4 cm and .3 kg is held through a shake of 1 s."""
    _held_through_a_shake(environment, 0.3)


@FINGERS
def each_pad_presses_with_the_force_of_the_gripper(environment: RobotTask) -> None:
    """Each pad presses a gripped cube with the declared force within 5 %."""
    cube = _lifted_cube(environment, 0.1)
    robot: Any = environment.robot
    measured = np.zeros(2)
    for _ in range(12):
        environment.step(np.array([0.0, 0.0, 0.0, -1.0]))
        touched = [environment.world.contacts(robot.body, cube, pad) for pad in robot.motors.pads]
        measured += [sum(contact.force for contact in contacts) / 12 for contacts in touched]
    declared = robot.gripper.force
    near = np.abs(measured / declared - 1) < 0.05
    demand(near.all(), f"the pads press with {measured.round(1)} N, the gripper declares {declared:g} N")


@FINGERS
def the_pads_are_as_far_apart_as_the_gripper_says(environment: RobotTask) -> None:
    """Around a cube of 4 cm the fingers are 4 cm apart within 1 mm, by the declared width and travel."""
    cube = _lifted_cube(environment, 0.1)
    robot: Any = environment.robot
    apart = robot.gripper.width - 2 * robot.model.fingers.travel * (1 - robot.opening)
    demand(robot.pads_gripping(cube) == 2, "the pads do not hold the cube with their inner faces")
    demand(abs(apart - SIZE) < 0.001, f"around a cube of 40 mm the pads are {1000 * apart:.1f} mm apart")


@CUP
def a_body_hangs_from_a_cup_up_to_its_force_and_no_further(environment: RobotTask) -> None:
    """A body with .97 of the cup's force as weight hangs from it for 1 s. With 1.03, or without suction, it falls."""
    robot: Any = environment.robot
    for share, opening, hangs in ((0.97, 0.0, True), (1.03, 0.0, False), (0.97, 1.0, False)):
        mass = share * robot.gripper.max_force / 9.81
        environment.reset(0)
        cube: Body = environment.task.cube  # type: ignore[attr-defined]
        cube.set_inertia(mass, (mass * SIZE**2 / 6,) * 3)
        place = robot.tool_position
        for step in range(24):
            environment.step(robot.towards(place, opening if step > 11 else 0.0))
        below = robot.tool_position[2] - cube.pose()[0][2]
        held = robot.pads_touching(cube) == 2 and abs(below - SIZE / 2) < 0.001
        found = f"{mass:.2f} kg at {robot.gripper.max_force:.1f} N is {1000 * below:.1f} mm below the cup"
        demand(held == hangs and (hangs or below > SIZE), found)


@GRIPPER
def the_wrist_weighs_what_the_gripper_holds(environment: RobotTask) -> None:
    """The wrench at the wrist is the weight of a held cube of .3 kg within 2 %, also with the tool tilted."""
    robot: Any = environment.robot
    environment.reset(0)
    cube: Body = environment.task.cube  # type: ignore[attr-defined]
    cube.set_inertia(0.3, (0.3 * SIZE**2 / 6,) * 3)
    place, felt = robot.tool_position, np.zeros(6)
    for turn in (robot.orientations.middle, robot.orientations.at(robot.orientations.tilt, 0.0, 0.0)):
        for step in range(48):
            environment.step(robot.towards(place, 0.0, turn))
            felt = felt + np.divide(robot.wrench, 12) if step >= 36 else np.zeros(6)
        weight = np.array(rotated(inverse(robot.tool.orientation), (0.0, 0.0, -0.3 * 9.81)))
        lever = rotated(inverse(robot.tool.orientation), np.subtract(cube.pose()[0], robot.tool_position).tolist())
        off = felt - np.concatenate((weight, np.cross(lever, weight)))
        near = np.abs(off[:3]).max() < 0.02 * 0.3 * 9.81 and np.abs(off[3:]).max() < 0.002 * 0.3 * 9.81
        demand(near, f"the wrist feels {felt.round(3)} of a weight of {weight.round(3)} N")


def _generator() -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(0))


def _full_actions(environment: RobotTask, count: int, *, held: int) -> Array:
    """Actions (count, n) of full size in random directions, each held for some steps."""
    signs: Array = np.sign(random_actions(environment.signature, count // held, _generator()))
    return signs.repeat(held, axis=0)


def _along(environment: RobotTask, axis: int, direction: float) -> Array:
    """The action (n,) that is full along one axis."""
    action = np.zeros(environment.signature.action.size)
    action[axis] = direction
    return action


def _creep(environment: RobotTask) -> float:
    """Distance in m that the tool moves at zero actions for 2 s after a reset."""
    before = environment.reset(1).achieved_goal
    for _ in range(48):
        step = environment.step(np.zeros(environment.signature.action.size))
    return float(np.linalg.norm(step.achieved_goal - before))


def _ends_of_the_arm(environment: RobotTask) -> Iterator[tuple[str, RandomizedParameter, float]]:
    """Name, declaration and value of the lower and of the upper end of each parameter of the arm's dynamics."""
    for name, declared in environment.robot.parameters.items():
        if name.startswith(("joint_", "link_", "motor_")):  # those of grip and observation are checked in `pairs`
            for value in (declared.low, declared.high):
                yield name, declared, value


def _rise(robot: Any) -> float:
    """Height in m of the tool above the centre of a cube that it holds."""
    return SIZE / 2 if isinstance(robot.gripper, Cup) else 0.0


def _lifted_cube(environment: RobotTask, mass: float, poses: list[Array] | None = None) -> Body:
    """Grip a cube of 4 cm and this mass in kg and lift it. Its poses (7,) after each step are added to `poses`."""
    environment.reset(0)
    robot: Any = environment.robot
    cube: Body = environment.task.cube  # type: ignore[attr-defined]
    cube.set_inertia(mass, (mass * SIZE**2 / 6,) * 3)
    x, y, _ = robot.workspace.centre
    cube.place((x, y, 0.02))
    top = min(0.3, robot.workspace.high[2])
    low = SIZE / 2 + _rise(robot)
    for height, opening, count in ((low, 1.0, 40), (low, 0.0, 20), (top, 0.0, 30)):
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
        if isinstance(robot.gripper, Gripper):
            first, second = robot.body.joints(robot.motors.pads)
            apart = max(apart, abs(first[0] - second[0]))
    creep = float(np.linalg.norm(position_in_gripper() - start))
    demand(creep < 0.002, f"a cube of {mass:g} kg creeps {1000 * creep:.1f} mm in the gripper")
    demand(apart < 0.001, f"the positions of the fingers differ by {1000 * apart:.1f} mm")
    return np.array(poses)
