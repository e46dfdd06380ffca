"""Control modes: what an arm's actions change, and how its motors follow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from math import atan2, cos, hypot, sin
from typing import Any, ClassVar, NamedTuple, Protocol

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
    vector,
)
from ..simulation.interface import Box, JointLimits, Motors, Spring
from ..simulation.kinematics import Chain, Configuration, Pose
from .settings import ArmSettings

POSITION = Field("tool_position", 3, "m", kind="point")
ROTATION = Field("tool_rotation", 6, kind="rotation")
"""The first two columns of the tool's rotation matrix."""
VELOCITY = Field("tool_velocity", 3, "m/s", kind="vector")
SPIN = Field("tool_angular_velocity", 3, "rad/s", kind="axial")
CHANGE = Field("tool_position_change", 3, kind="vector")
POSTURE_GAIN = 0.1
"""Fraction of the way back to the home pose, per control step, that inverse kinematics takes in the null space."""
TOOL_SPEED_SHARE = 0.98
"""Fraction of the tool's largest speed at the end of a control step. The rest is for the motion inside the step."""
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
    tool_speed: float
    motors: Motors
    configuration: Configuration
    joint_positions: Array
    joint_velocities: Array
    tool_position: Vector
    tool_velocity: Vector
    tool_spin: Vector

    @property
    def steps_down(self) -> float: ...

    def value(self, name: str) -> float: ...


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
        kernel: name of the function that turns actions into ramps, in `control_kernel`, which explains both.
    """

    turns_joints: ClassVar[bool] = False
    turns_tool: ClassVar[bool] = True
    observed: tuple[Field, ...] = (POSITION, VELOCITY)
    observed_joints: tuple[Field, ...] = ()
    action: tuple[Field, ...]
    kernel: ClassVar[str]

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
        """Set up the motors of a loaded arm, and what the compiled code needs."""
        arm, settings = self.arm, self.arm.settings
        self._kernel: Any = (kernel := import_module(".control_kernel", __package__))  # heavy, so it is imported here
        limits, turns = arm.limits, arm.orientations
        rows = limits.lower, limits.upper, limits.velocity, arm.accelerations, arm.joint_step, arm.home_joints
        self._joints = np.array(rows)
        self._state = np.zeros((2, arm.chain.size))
        self._ramp = getattr(kernel, self.kernel).unchecked()
        self._law = kernel.Law(
            period=arm.period,
            most=TOOL_SPEED_SHARE * arm.tool_speed,
            damping=arm.chain.damping,
            gain=POSTURE_GAIN,
            steps_down=float(arm.steps_down),
            low=vector(arm.workspace.low),
            high=vector(arm.workspace.high),
            tool_step=arm.tool_step,
            turn_step=settings.turn_step,
            own_frame=settings.frame == "tool",
            yaw=arm.home_yaw,
            yaw_step=settings.yaw_step if settings.yaw else 0.0,
            middle=turns.middle,
            tilt=float(turns.tilt),
            turn=float(turns.turn),
        )

    def reset(self) -> None:
        """Begin an episode, with the joints in their places and at rest."""
        self._state[:] = self.arm.joint_positions, np.zeros(self.arm.chain.size)

    def act(self, values: Sequence[float], openings: Mapping[int, float]) -> None:
        """Aim the motors for one control step: joints on ramps of their speeds, the gripper as `Motors.drive` says.

        The numbers of an action are in [-1, 1].
        """
        arm, chain = self.arm, self.arm.chain
        ramps, numbers = np.empty((2, chain.size)), arm.configuration.numbers
        where = self._law, self._joints, chain.base, chain.links, self._state
        self._ramp(*where, arm.joint_positions, arm.joint_velocities, numbers, np.array(values), ramps)
        arm.motors.drive(ramps, openings)

    def observe(self) -> list[float]:
        """The numbers of `observed`."""
        return [*self.arm.tool_position, *self.arm.tool_velocity]

    def observe_joints(self) -> Sequence[float]:
        """The numbers of `observed_joints`."""
        return ()

    def towards(self, way: Way) -> list[float]:
        """The action that leads along a way."""
        raise NotImplementedError


class JointControl(Control):
    """An action changes each joint position, in units of the joint step.

    With `joint_slots` (s) observations and actions fit arms with any number of joints up to s. Each joint is described
    by what it does now, not by its angle, whose zero is arbitrary. Places without a joint are 0. Actions ignore them.
    """

    turns_joints, kernel = True, "turn_joints"

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

    turns_tool, kernel = False, "move_tool"

    def __init__(self, arm: ControlledArm) -> None:
        super().__init__(arm)
        self._yaws = arm.settings.yaw
        self.action = (CHANGE,)
        if self._yaws:
            self.action += (Field("yaw_change", 1, kind="axial"),)
            self.observed += (Field("tool_heading", 2, kind="vector"),)  # cosine and sine: an angle would jump

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
    kernel = "move_pose"

    def observe(self) -> list[float]:
        arm, tool = self.arm, self.arm.configuration.tool
        return [*tool.position, *tool.x, *tool.y, *arm.tool_velocity, *arm.tool_spin]

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
        super().build()
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
        (x, y, z), orientation, own = self._position, self._orientation, arm.configuration.tool.orientation
        changed = self._kernel.changed(self._law, (x, y, z), orientation, own, np.array(values), arm.workspace.low[2])
        self._position, self._orientation = changed
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
