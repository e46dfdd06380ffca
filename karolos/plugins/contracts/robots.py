"""What every robot promises of its motion, under each control mode; `grippers` says what of its grip."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np

from ...core import FloatArray
from ...environments.robot_task import RobotTask
from .case import Candidate, demand, demand_same
from .joined import reaching

SPARE = 1.05
"""Share of its speed that a joint may reach at the most: the solver's."""


def no_joint_exceeds_its_speed_under_the_hardest_actions(one: Candidate) -> None:
    """Full turns to and fro bring no joint over its speed or out of its range."""
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
            demand(inside.all(), f"joint {int(np.argmin(inside))} leaves its range")
        worst = int(np.argmax(fastest / speeds))
        demand(
            (fastest <= SPARE * speeds).all(),
            f"joint {worst} reaches {fastest[worst]:.3g} of {speeds[worst]:.3g} rad/s",
        )
        demand((fastest > 0.5 * speeds).any(), "the hardest actions bring no joint to half its speed")


def the_tool_reaches_every_corner_of_the_workspace(one: Candidate) -> None:
    """Steered there, the tool comes within 5 mm of every corner, edge and face of the workspace declared."""
    with reaching(one) as environment:
        robot = environment.robot
        box = robot.workspace
        for share in product((0.0, 0.5, 1.0), repeat=3):
            x, y, z = (low + (high - low) * part for low, high, part in zip(box.low, box.high, share, strict=True))
            environment.reset(0)
            for _ in range(45):
                environment.step(robot.towards((x, y, z), 0.0))
            left = float(np.linalg.norm(np.subtract(robot.tool_position, (x, y, z))))
            demand(left < 0.005, f"the tool stays {1000 * left:.1f} mm away from {x:.3f} {y:.3f} {z:.3f}")


def an_arm_at_rest_stays_where_it_is(one: Candidate) -> None:
    """Actions of zeros leave the tool where it is, within 2 mm over 2 s."""
    with reaching(one) as environment:
        before = environment.reset(1).achieved_goal
        for _ in range(48):
            step = environment.step(np.zeros(environment.signature.action.size))
        moved = float(np.linalg.norm(step.achieved_goal - before))
        demand(moved < 0.002, f"the tool has moved {1000 * moved:.1f} mm")


def the_state_of_the_tool_is_that_of_the_physics(one: Candidate) -> None:
    """The tool's position and velocity by kinematics are those of the last link in the world."""
    with reaching(one) as environment:
        robot: Any = environment.robot
        draws = _generator()
        environment.reset(2)
        for _ in range(10):
            before = np.array(robot.tool_position)
            environment.step(draws.uniform(-1, 1, environment.signature.action.size))
            speed = float(np.linalg.norm((np.array(robot.tool_position) - before) * 24))
            demand(speed < 3, f"the tool travels at {speed:.2f} m/s")
            state = _body(environment).link(len(robot.limits.lower) - 1, moved=True)
            offset = np.linalg.norm(np.array(robot.tool_position) - state.position)
            length = np.linalg.norm(robot.model.tool)
            demand(
                abs(offset - length) < 1e-6, f"the tool is {offset:.6f} m from the last link instead of {length:.6f}"
            )
            arm = np.array(robot.tool_position) - state.centre
            velocity = np.array(state.velocity) + np.cross(state.angular_velocity, arm)
            near = np.allclose(robot.tool_velocity, velocity, atol=1e-5)
            demand(near, f"the tool's velocity is {robot.tool_velocity}, that of its link {velocity}")


def home_lies_in_the_workspace_and_the_tool_points_down(one: Candidate) -> None:
    """At home the tool lies in the workspace and points down."""
    with reaching(one) as environment:
        robot = environment.robot
        demand(robot.workspace.contains(robot.home), f"home, {robot.home}, lies outside the workspace")
        pose: Any = robot.forward(robot.home_joints).tool
        demand(np.allclose(pose.z, (0, 0, -1), atol=1e-3), f"at home the tool points to {pose.z} instead of down")


def the_tool_can_be_placed_at_a_reset(one: Candidate) -> None:
    """`place_tool` puts the tool where it is asked, within 1 mm."""
    with reaching(one) as environment:
        environment.reset(0)
        robot = environment.robot
        robot.place_tool(robot.workspace.centre, 1.0)
        left = float(np.linalg.norm(np.subtract(robot.tool_position, robot.workspace.centre)))
        demand(left < 0.001, f"the tool is {1000 * left:.1f} mm away from where it was placed")


def each_parameter_changes_the_motion_and_can_be_taken_back(one: Candidate) -> None:
    """Each parameter declared changes the motion, and its nominal value brings the same motion back."""
    with reaching(one) as environment:
        robot = environment.robot

        def end() -> FloatArray:
            draws = _generator()
            environment.reset(0)
            for _ in range(10):
                step = environment.step(draws.uniform(-1, 1, environment.signature.action.size))
            return step.observation

        nominal = end()
        for name, declared in robot.parameters.items():
            if not name.startswith(("joint_", "link_", "motor_")):
                continue  # of what is gripped, or of what is observed: see `pairs`
            robot.apply(name, declared.high)
            changed = float(np.abs(end() - nominal).max())
            robot.apply(name, declared.nominal)
            demand(changed > 1e-5, f"{name} changes nothing")
            demand_same(end(), nominal, f"observations after {name} has its nominal value again")


def every_joint_reaches_its_speed_when_it_goes_far(one: Candidate) -> None:
    """A joint that goes as far as it can comes to its speed."""
    with reaching(one) as environment:
        robot = environment.robot
        for joint, speed in enumerate(robot.limits.velocity):
            fastest = 0.0
            for way in (-1.0, 1.0):  # one way may be short, or lead into the floor
                environment.reset(0)
                action = np.zeros(environment.signature.action.size)
                action[joint] = way
                for _ in range(12):
                    environment.step(action)
                    fastest = max(fastest, abs(robot.joint_velocities[joint]))
            demand(0.9 * speed < fastest < SPARE * speed, f"joint {joint} reaches {fastest:.3g} of {speed:.3g} rad/s")


ANY_CONTROL: tuple[Callable[[Candidate], None], ...] = (
    no_joint_exceeds_its_speed_under_the_hardest_actions,
    the_tool_reaches_every_corner_of_the_workspace,
    an_arm_at_rest_stays_where_it_is,
    the_state_of_the_tool_is_that_of_the_physics,
    home_lies_in_the_workspace_and_the_tool_points_down,
    the_tool_can_be_placed_at_a_reset,
    each_parameter_changes_the_motion_and_can_be_taken_back,
)
JOINT_CONTROL: tuple[Callable[[Candidate], None], ...] = (every_joint_reaches_its_speed_when_it_goes_far,)


def _generator() -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(0))


def _body(environment: RobotTask) -> Any:
    """The arm's body in the world, which tasks do not see."""
    return environment.robot.body  # type: ignore[attr-defined]
