"""Control modes: what an arm's actions change, and how its motors follow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import atan2, cos, hypot, sin
from typing import ClassVar, NamedTuple, Protocol

import numpy as np

from ..core import Array, Field, Kind
from ..errors import UsageError
from ..simulation.geometry import (
    Orientations,
    Quaternion,
    Vector,
    inverse,
    multiply,
    rotated,
    rotation_about,
    rotation_vector,
)
from ..simulation.interface import Box, JointLimits, Motors, Spring
from ..simulation.kinematics import Chain, Configuration, Pose, downward
from .ramps import Ramps
from .settings import ArmSettings

POSITION = Field("tool_position", 3, "m", kind="point")
ROTATION = Field("tool_rotation", 6, kind="rotation")
"""The first two columns of the tool's rotation matrix."""
VELOCITY = Field("tool_velocity", 3, "m/s", kind="vector")
SPIN = Field("tool_angular_velocity", 3, "rad/s", kind="axial")
CHANGE = Field("tool_position_change", 3, kind="vector")
MOST_ROOM = 10.0
"""Joint steps; a joint that is farther from the end of its range is described as if it were so near."""


class ControlledArm(Protocol):
    """The part of an arm that a control mode needs, see `arm.Arm`."""

    settings: ArmSettings
    limits: JointLimits
    chain: Chain
    workspace: Box
    orientations: Orientations
    home_yaw: float
    home_joints: tuple[float, ...]
    period: float
    tool_step: float
    joint_step: tuple[float, ...]
    accelerations: tuple[float, ...]
    motors: Motors
    ramps: Ramps
    configuration: Configuration
    joint_positions: Array
    joint_velocities: Array
    tool_position: Vector
    tool_velocity: Vector

    def value(self, name: str) -> float: ...

    def posture(self, joints: Array) -> Array: ...

    def lowest(self) -> float: ...


class Way(NamedTuple):
    """The way that an expert wants the tool to go."""

    target: Pose
    joints: Array
    """Change of each joint that leads there, in rad."""
    slower: float
    """Smallest factor by which the motion must be slower than in one step, to stop in time."""


class Control:
    """A control mode of an arm.

    Attributes:
        turns_joints: whether actions change joint positions.
        turns_tool: whether the tool may be turned away from pointing down.
        observed: observed fields of the tool.
        observed_joints: observed fields of the joints.
        action: fields of the action, without the gripper.
    """

    turns_joints: ClassVar[bool] = False
    turns_tool: ClassVar[bool] = True
    observed: tuple[Field, ...] = (POSITION, VELOCITY)
    observed_joints: tuple[Field, ...] = ()
    action: tuple[Field, ...]

    def __init__(self, arm: ControlledArm) -> None:
        self.arm = arm
        self._most = np.array(arm.joint_step)

    @property
    def scales(self) -> dict[str, tuple[str, list[float]]]:
        """Largest change by an action of 1 in a control step: field of `action` -> unit, and change of each column."""
        arm = self.arm
        return {
            **({} if arm.settings.joint_slots else {"joint_changes": ("rad", list(arm.joint_step))}),
            "tool_position_change": ("m", [arm.tool_step] * 3),
            "yaw_change": ("rad", [arm.settings.yaw_step]),
            "tool_turn": ("rad", [arm.settings.turn_step] * 3),
        }

    def build(self) -> None:
        """Set up the motors of a loaded arm."""

    def reset(self) -> None:
        """Begin an episode, with the joints in their places and at rest."""

    def changes(self, values: Sequence[float]) -> Array:
        """Changes of the joints (n,) in rad that an action means, its numbers in [-1, 1]."""
        raise NotImplementedError

    def act(self, values: Sequence[float], openings: Mapping[int, float]) -> None:
        """Aim the motors for one control step: joints on ramps of their speeds, the gripper as `Motors.drive` says."""
        arm = self.arm
        changes = self.changes(values)
        ramp = arm.ramps.ramp(arm.joint_positions, arm.joint_velocities, changes, arm.configuration)
        arm.motors.drive(ramp, openings)

    def observe(self) -> list[float]:
        """The numbers of `observed`."""
        return [*self.arm.tool_position, *self.arm.tool_velocity]

    def observe_joints(self) -> Sequence[float]:
        """The numbers of `observed_joints`."""
        return ()

    def towards(self, way: Way) -> list[float]:
        """The action that leads along a way."""
        raise NotImplementedError

    def _within_steps(self, target: Pose) -> Array:
        """Change of the joints (n,) towards a pose of the tool, scaled down so that no joint exceeds its step.

        Near the lower end of the workspace the target is raised by what the way there curves down.
        """
        arm, (x, y, z) = self.arm, target.position
        posture, lowest = arm.posture(arm.joint_positions), arm.lowest()
        changes = arm.chain.step(arm.configuration, target, posture, self._most)
        # with steps of 3.4 cm at most 7 mm were measured (a UR5, full actions), so half a step is near enough to look
        if z < lowest + arm.tool_step / 2 and z < (raised := lowest + self._sinks(changes)):
            changes = arm.chain.step(arm.configuration, target._replace(position=(x, y, raised)), posture, self._most)
        return changes

    def _sinks(self, changes: Array) -> float:
        """How far in m the tool comes to rest below a straight way, because joints that turn lead it on a curve.

        It is twice the distance at the end of the step: the tool then moves down, and the next step takes as long to
        brake it.
        """
        arm, half, speeds = self.arm, self.arm.period / 2, changes / self.arm.period
        end = arm.chain.forward(arm.joint_positions + half * (arm.joint_velocities + speeds)).tool.position[2]
        fall = arm.tool_velocity[2] + arm.chain.velocity(arm.configuration, speeds)[2]
        return 2 * (arm.tool_position[2] + half * fall - end)

    def _ahead(self, start: Vector, change: Sequence[float], low_z: float) -> Vector:
        """The position that is `change` m away from `start`, inside the workspace and not lower than `low_z`."""
        (low_x, low_y, _), (high_x, high_y, high_z) = self.arm.workspace.low, self.arm.workspace.high
        (x, y, z), (dx, dy, dz) = start, change
        return min(max(x + dx, low_x), high_x), min(max(y + dy, low_y), high_y), min(max(z + dz, low_z), high_z)


class JointControl(Control):
    """An action changes each joint position, in units of the joint step.

    With `joint_slots` (s) observations and actions fit arms with any number of joints up to s. Each joint is described
    by what it does now, not by its angle, whose zero is arbitrary. Places without a joint are 0. Actions ignore them.
    """

    turns_joints = True

    def __init__(self, arm: ControlledArm) -> None:
        super().__init__(arm)
        size, slots = arm.chain.size, arm.settings.joint_slots
        self._spare = (slots or size) - size
        if self._spare < 0:
            what, hint = f"this arm has {size} joints", f"set it to {size} or more, in training too"
            raise UsageError(what, setting="robot.joint_slots", hint=hint)
        if slots is None:
            self.action = (Field("joint_changes", size),)
            self.observed_joints = Field("joint_positions", size, "rad"), Field("joint_velocities", size, "rad/s")
            return

        def described(name: str, unit: str, kind: Kind = "scalar", each: int = 1) -> Field:
            size = slots * each * (6 if kind == "wrench" else 1)
            return Field(name, size, unit, kind=(kind,) * slots * each, joints=slots)

        self.action = (described("joint_changes", "1"),)
        self.observed_joints = (
            described("joint_effects", "m, rad", "wrench"),
            described("joint_rooms", "joint steps", each=2),
            described("joint_speeds", "joint steps"),
            described("joint_accelerations", "joint steps"),
        )

    def changes(self, values: Sequence[float]) -> Array:
        return self._most * values[: len(self._most)]

    def observe_joints(self) -> Sequence[float]:
        arm = self.arm
        if arm.settings.joint_slots is None:
            return [*arm.joint_positions.tolist(), *arm.joint_velocities.tolist()]
        step = self._most
        effects = arm.chain.jacobian(arm.configuration).T * step[:, None]
        below = (arm.joint_positions - arm.limits.lower) / step
        above = (arm.limits.upper - arm.joint_positions) / step
        rooms = np.clip(np.column_stack((below, above)), 0, MOST_ROOM)
        speeds = arm.period * arm.joint_velocities / step
        # Above 1 a joint has its full speed within one control step.
        accelerations = np.minimum(arm.period**2 * np.array(arm.accelerations) / step, 1)
        values: list[float] = []
        for part in (effects, rooms, speeds, accelerations):
            values += part.ravel().tolist()
            values += [0.0] * (part.size // arm.chain.size * self._spare)
        return values

    def towards(self, way: Way) -> list[float]:
        shares = [ahead / step for ahead, step in zip(way.joints, self.arm.joint_step, strict=True)]
        longest = max(way.slower, *map(abs, shares))
        return [*(share / longest for share in shares), *[0.0] * self._spare]


class CartesianControl(Control):
    """An action changes the position of the tool, which points down, and with the setting `yaw` its yaw."""

    turns_tool = False

    def __init__(self, arm: ControlledArm) -> None:
        super().__init__(arm)
        self._yaws = arm.settings.yaw
        self.action = (CHANGE,)
        if self._yaws:
            self.action += (Field("yaw_change", 1, kind="axial"),)
            self.observed += (Field("tool_heading", 2, kind="vector"),)  # cosine and sine: an angle would jump

    def changes(self, values: Sequence[float]) -> Array:
        arm = self.arm
        step = arm.tool_step
        change = step * values[0], step * values[1], step * values[2]
        yaw = self._yaw() + arm.settings.yaw_step * values[3] if self._yaws else arm.home_yaw
        return self._within_steps(downward(self._ahead(arm.tool_position, change, arm.lowest()), yaw))

    def observe(self) -> list[float]:
        values = super().observe()
        if self._yaws:
            yaw = self._yaw()
            values += (cos(yaw), sin(yaw))
        return values

    def towards(self, way: Way) -> list[float]:
        arm = self.arm
        difference = [wanted - current for wanted, current in zip(way.target.position, arm.tool_position, strict=True)]
        longest = max(way.slower, max(abs(value) for value in difference) / arm.tool_step)
        values = [value / arm.tool_step / longest for value in difference]
        if self._yaws:
            turn = arm.home_yaw - self._yaw()
            values.append(atan2(sin(turn), cos(turn)) / arm.settings.yaw_step)
        return values

    def _yaw(self) -> float:
        """Current yaw of the tool's x axis, in rad."""
        x, y, _ = self.arm.configuration.tool.x
        return atan2(y, x)


class PoseControl(Control):
    """An action changes the position of the tool and turns it by a rotation vector, in the base's or the tool's frame.

    The pose aimed at stays in the workspace and within the arm's orientations.
    """

    observed: tuple[Field, ...] = (POSITION, ROTATION, VELOCITY, SPIN)
    action: tuple[Field, ...] = (CHANGE, Field("tool_turn", 3, kind="axial"))

    def changes(self, values: Sequence[float]) -> Array:
        tool = self.arm.configuration.tool
        return self._within_steps(Pose.at(*self._changed(tool.position, tool.orientation, values, self.arm.lowest())))

    def _changed(
        self, position: Vector, orientation: Quaternion, values: Sequence[float], low_z: float
    ) -> tuple[Vector, Quaternion]:
        """The pose that an action makes of this one."""
        arm = self.arm
        shift, turn = [arm.tool_step * value for value in values[:3]], self._turn(values[3:6])
        if arm.settings.frame == "tool":
            own = arm.configuration.tool.orientation
            shift, turn = list(rotated(own, shift)), rotated(own, turn)
        turned = multiply(rotation_about(turn), orientation)
        return self._ahead(position, shift, low_z), arm.orientations.nearest(turned)

    def _turn(self, values: Sequence[float]) -> Vector:
        x, y, z = (self.arm.settings.turn_step * value for value in values)
        return x, y, z

    def observe(self) -> list[float]:
        arm = self.arm
        tool, spin = arm.configuration.tool, arm.chain.spin(arm.configuration, arm.joint_velocities)
        return [*tool.position, *tool.x, *tool.y, *arm.tool_velocity, *spin]

    def towards(self, way: Way) -> list[float]:
        return self._way(self.arm.configuration.tool, way.target, way.slower)

    def _way(self, start: Pose, target: Pose, slower: float) -> list[float]:
        """The action that leads from one pose to another, slower than in one step by at least this factor."""
        arm = self.arm
        shift: Sequence[float] = [there - here for there, here in zip(target.position, start.position, strict=True)]
        turn = rotation_vector(multiply(target.orientation, inverse(start.orientation)))
        if arm.settings.frame == "tool":
            back = inverse(arm.configuration.tool.orientation)
            shift, turn = rotated(back, shift), rotated(back, turn)
        values = [value / arm.tool_step for value in shift] + [value / arm.settings.turn_step for value in turn]
        longest = max(slower, *map(abs, values))
        return [value / longest for value in values]


class ImpedanceControl(PoseControl):
    """As pose control, but an action moves the set point of a spring and damper at the tool, which gives way.

    The set point stays where actions moved it. With zero actions the arm holds its place under a load. With further
    actions it presses on a wall, up to the force of the largest error. (A set point that starts at the tool in each
    step would sink with a load, and could press only with the force of one step.) The part of the error above the
    largest one is discarded, so that the way back from a wall is short. The next step depends only on the rest, which
    is observed as `set_point`: the way from the tool to the set point in m, and as a rotation vector in rad. Multiplied
    by the stiffness it is the force.
    """

    observed = (*PoseControl.observed, Field("set_point", 6, "m, rad", kind="wrench"))

    def __init__(self, arm: ControlledArm) -> None:
        super().__init__(arm)
        self._still = np.zeros((2, arm.chain.size))
        if arm.settings.stiffness_range is not None:
            self.action = (*PoseControl.action, Field("stiffness", 1, kind="scalar"))

    def build(self) -> None:
        self._attach(self.arm.settings.stiffness)

    def _attach(self, stiffness: float) -> None:
        """Let a spring with this stiffness in N/m move the tool. Its other numbers are those of the episode."""
        settings, value = self.arm.settings, self.arm.value
        limits = settings.error_limit, settings.turn_error_limit
        self.arm.motors.attach(
            Spring(stiffness, value("turn_stiffness"), value("damping_ratio"), *limits, self.arm.home_joints)
        )

    def reset(self) -> None:
        self._attach(self.arm.value("stiffness"))
        tool = self.arm.configuration.tool
        self._position, self._orientation = tool.position, tool.orientation
        self.arm.motors.aim(self._position, self._orientation, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    def act(self, values: Sequence[float], openings: Mapping[int, float]) -> None:
        arm = self.arm
        arm.motors.drive(self._still, openings)
        if arm.settings.stiffness_range is not None:
            low, high = arm.settings.stiffness_range
            self._attach(low * (high / low) ** (0.5 + 0.5 * values[6]))
        self._cut()
        (x, y, z), orientation = self._position, self._orientation
        self._position, self._orientation = self._changed((x, y, z), orientation, values, arm.workspace.low[2])
        self._cut()
        (end_x, end_y, end_z), (a, b, c) = self._position, self._turned(orientation)
        speed = (end_x - x) / arm.period, (end_y - y) / arm.period, (end_z - z) / arm.period
        arm.motors.aim((x, y, z), orientation, speed, (a / arm.period, b / arm.period, c / arm.period))

    def _cut(self) -> None:
        """Move the set point towards the tool until no error exceeds the largest."""
        tool, (error, turn) = self.arm.configuration.tool, self._error()
        x, y, z = (own + ahead for own, ahead in zip(tool.position, error, strict=True))
        self._position, self._orientation = (x, y, z), multiply(rotation_about(turn), tool.orientation)

    def _error(self) -> tuple[Vector, Vector]:
        """The way from the tool to the set point, m and rad, no longer than the largest error."""
        settings, tool = self.arm.settings, self.arm.configuration.tool
        x, y, z = (there - here for there, here in zip(self._position, tool.position, strict=True))
        turn = self._turned(tool.orientation)
        return _shortened((x, y, z), settings.error_limit), _shortened(turn, settings.turn_error_limit)

    def _turned(self, orientation: Quaternion) -> Vector:
        """The rotation vector in rad from an orientation to that of the set point."""
        return rotation_vector(multiply(self._orientation, inverse(orientation)))

    def observe(self) -> list[float]:
        error, turn = self._error()
        return [*super().observe(), *error, *turn]

    def towards(self, way: Way) -> list[float]:
        values = self._way(Pose.at(self._position, self._orientation), way.target, 1.0)
        return values if self.arm.settings.stiffness_range is None else [*values, 0.0]


def _shortened(vector: Vector, most: float) -> Vector:
    """The vector, no longer than this."""
    share = min(1.0, most / max(hypot(*vector), 1e-12))
    return share * vector[0], share * vector[1], share * vector[2]


CONTROLS: Mapping[str, type[Control]] = {
    "joint": JointControl,
    "cartesian": CartesianControl,
    "pose": PoseControl,
    "impedance": ImpedanceControl,
}
"""Control modes by the names that specs give them."""
