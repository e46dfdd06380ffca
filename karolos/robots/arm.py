"""Every serial arm: a robot file gives an `ArmModel` and the defaults of its settings, and this does the work.

Control modes: `joint` (change of each joint position) and `cartesian` (change of the tool position, gripper pointing
down). The latter has the same action and observation layout for every arm.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from functools import cached_property
from math import atan2, cos, dist, hypot, sin
from operator import truediv
from typing import ClassVar

import numpy as np

from ..core import Field, FloatArray, Layout
from ..core.seeding import Generator
from ..errors import PluginError, UsageError
from ..randomization.parameter import Parameter
from ..simulation import urdf
from ..simulation.body import Body, Vector
from ..simulation.interface import Gripper, JointLimits
from ..simulation.kinematics import Chain, Configuration
from ..simulation.world import World
from .drives import Drives
from .model import PARAMETERS, ArmModel, ArmSettings, pad_friction

POSTURE_GAIN = 0.1
"""Share of the way back to the home pose, per control step, that the null space is used for."""
PLACED = 5e-4
"""How near, in m, and how upright, in rad, `place_tool` brings the tool."""
NOMINAL = {name: parameter.nominal for name, parameter in PARAMETERS.items()}


class Arm:
    """Implements `karolos.simulation.interface.Robot` for a serial arm; a subclass sets `model` and `Settings`."""

    Settings: ClassVar[type[ArmSettings]]
    model: ClassVar[ArmModel]

    def __init__(self, settings: ArmSettings) -> None:
        self.settings = settings
        model = self.model
        self._joints = [joint for joint in urdf.joints(model.urdf) if joint.revolute]
        if len(self._joints) != len(model.home):
            raise PluginError(
                f"{len(self._joints)} revolute joints, but a home pose of {len(model.home)}", where=str(model.urdf)
            )
        self.limits = JointLimits(
            *(tuple(getattr(joint, key) for joint in self._joints) for key in ("lower", "upper", "velocity", "effort"))
        )
        self.chain = Chain(self._joints, (np.array(model.tool), urdf.rotation_matrix(*model.tool_rpy)))
        self._at = self.chain.forward(model.home)
        pose = self._at.tool
        self.home = pose.position
        self.home_yaw = atan2(pose.x[1], pose.x[0])
        self.workspace = model.workspace
        self.reset_noise = settings.reset_noise
        self._fingers = model.fingers
        self._values = dict(NOMINAL)
        self._positions: Sequence[float] = model.home
        self._velocities: Sequence[float] = (0.0,) * len(model.home)
        self._delayed: deque[list[float]] = deque()
        self.tool_position: Vector = self.home
        self.tool_velocity: Vector = (0.0, 0.0, 0.0)
        self.opening = 0.0
        self.prepare(gripper=False, period=1 / 24)

    @property
    def turns_joints(self) -> bool:
        return not self._cartesian

    @property
    def home_joints(self) -> tuple[float, ...]:
        return self.model.home

    @property
    def joint_positions(self) -> Sequence[float]:
        return self._positions

    @property
    def joint_velocities(self) -> Sequence[float]:
        return self._velocities

    def forward(self, joints: Sequence[float]) -> Configuration:
        return self.chain.forward(joints)

    @property
    def gripper(self) -> Gripper | None:
        return self.model.fingers.facts if self.model.fingers else None

    def prepare(self, *, gripper: bool, period: float, points_down: bool = True) -> None:
        if gripper and self.model.fingers is None:
            raise PluginError("this robot has no gripper", where=type(self).__name__, hint="choose a task without one")
        self._fingers = self.model.fingers if gripper else None
        self._cartesian = (self.settings.control or ("cartesian" if points_down else "joint")) == "cartesian"
        self._yaws = self._cartesian and self.settings.yaw
        self.period = period
        self.joint_step = tuple(min(self.settings.joint_step, speed * period) for speed in self.limits.velocity)
        self.tool_step = self.settings.tool_step

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        if self._fingers is None:
            return PARAMETERS
        return {**PARAMETERS, "pad_friction": pad_friction(self._fingers.facts.pad_friction)}

    @cached_property
    def observation(self) -> Layout:
        fields = [Field("tool_position", 3, "m"), Field("tool_velocity", 3, "m/s")]
        if self._yaws:
            fields.append(Field("tool_heading", 2, "1"))  # cosine and sine: an angle would jump
        if self._fingers is not None:
            fields.append(Field("gripper_opening", 1, "1"))
        if not self._cartesian:
            size = self.chain.size
            fields += [Field("joint_positions", size, "rad"), Field("joint_velocities", size, "rad/s")]
        return Layout(tuple(fields))

    @cached_property
    def action(self) -> Layout:
        fields = [Field("tool_position_change", 3, "1") if self._cartesian else Field("joint_changes", self.chain.size)]
        if self._yaws:
            fields.append(Field("yaw_change", 1))
        if self._fingers is not None:
            fields.append(Field("gripper_opening", 1))  # -1 closed, 1 open
        return Layout(tuple(fields))

    def build(self, world: World) -> None:
        robot = urdf.read(self.model.urdf)
        fingers = self.model.fingers
        if fingers is not None and self._fingers is None:
            robot = urdf.weld(robot, dict.fromkeys(fingers.joints, fingers.position(0.0)))
        self.world = world
        self.body = world.load(robot)
        links = self.body.links()
        known = {**links, self._joints[0].parent: -1}  # welded fingers are no links of their own
        pairs = [(known[a], known[b]) for a, b in self.model.self_collisions if a in known and b in known]
        self.body.collide_only(pairs)
        self._drives = Drives(world, self.body, [links[joint.child] for joint in self._joints], self.limits)
        if self._fingers is not None:
            self._drives.add_fingers(self._fingers, [links[name] for name in self._fingers.links])

    def apply(self, name: str, value: float) -> None:
        if name == "pad_friction":
            self._drives.set_pad_friction(value)
        elif name == "joint_damping":
            self._drives.set_damping(value)
        elif name == "link_mass":
            self._drives.set_mass(value)
        elif name == "joint_friction":
            self._drives.set_friction(value)
        elif name == "motor_gain":
            self._drives.set_gain(value)
        else:  # observation_noise, action_delay
            self._values[name] = value

    def reset(self, generator: Generator) -> None:
        home, noise = self.model.home, self.reset_noise
        self._generator = generator
        still = [0.0] * self.action.size
        if self._fingers is not None:
            still[-1] = 1.0  # as the gripper is after a reset
        self._delayed = deque(still for _ in range(round(self._values["action_delay"])))
        turns = generator.uniform(-noise, noise, len(home)).tolist()
        self._place([position + turn for position, turn in zip(home, turns, strict=True)], 1.0)

    def _place(self, positions: Sequence[float], opening: float) -> None:
        """Put the joints there at rest, within their limits, and aim the motors at just that."""
        limits = self.limits
        clipped = [
            min(max(value, low), high) for value, low, high in zip(positions, limits.lower, limits.upper, strict=True)
        ]
        self._drives.write(clipped, opening)
        self.read()

    def place_tool(self, position: Vector, opening: float) -> None:
        joints: list[float] = list(self.model.home)
        for _ in range(100):
            at = self.chain.forward(joints)
            if dist(at.tool.position, position) < PLACED and hypot(*at.tool.z[:2]) < PLACED:
                break
            change = self.chain.step(at, position, self.home_yaw, self._posture(joints))
            joints = [
                min(max(value + turn, low), high)
                for value, turn, low, high in zip(joints, change, self.limits.lower, self.limits.upper, strict=True)
            ]
        reached = self.chain.forward(joints).tool.position
        if np.linalg.norm(np.subtract(reached, position)) > 0.005:
            raise PluginError(
                f"the tool cannot be at {tuple(round(value, 3) for value in position)} m",
                where=type(self).__name__,
                hint=f"its workspace is {self.workspace.low} to {self.workspace.high}",
            )
        self._place(joints, opening)

    def _posture(self, joints: Sequence[float]) -> list[float]:
        return [POSTURE_GAIN * (home - value) for home, value in zip(self.model.home, joints, strict=True)]

    def act(self, action: Sequence[float]) -> None:
        values = [-1.0 if value < -1.0 else 1.0 if value > 1.0 else value for value in action]
        if self._delayed:
            self._delayed.append(values)
            values = self._delayed.popleft()
        opening = None if self._fingers is None else 0.5 + 0.5 * values[-1]
        if not self._cartesian:
            turns = [step * value for step, value in zip(self.joint_step, values, strict=False)]
            self._drives.turn(self._positions, self._velocities, turns, opening)
            return
        step, (x, y, z) = self.tool_step, self.tool_position
        low, high = self.workspace.low, self.workspace.high
        target = (
            min(max(x + step * values[0], low[0]), high[0]),
            min(max(y + step * values[1], low[1]), high[1]),
            min(max(z + step * values[2], low[2]), high[2]),
        )
        yaw = self.home_yaw
        if self._yaws:
            heading = self._at.tool.x
            yaw = atan2(heading[1], heading[0]) + self.settings.yaw_step * values[3]
        self._drives.turn(self._positions, self._velocities, self._turns_to(target, yaw), opening)

    def _turns_to(self, target: Vector, yaw: float) -> list[float]:
        """Change of the joints towards a tool position, shortened so that no joint goes further than its step."""
        change = self.chain.step(self._at, target, yaw, self._posture(self._positions))
        excess = max(map(truediv, map(abs, change), self.joint_step))
        return [turn / excess for turn in change] if excess > 1 else change

    def read(self) -> None:
        self._positions, self._velocities, self.opening = self._drives.read()
        self._at = at = self.chain.forward(self._positions)
        self.tool_position = at.tool.position
        self.tool_velocity = self.chain.velocity(at, self._velocities)

    def observe(self) -> list[float]:
        values = [*self.tool_position, *self.tool_velocity]
        if self._yaws:
            heading = self._at.tool.x
            yaw = atan2(heading[1], heading[0])
            values += (cos(yaw), sin(yaw))
        if self._fingers is not None:
            values.append(self.opening)
        if not self._cartesian:
            values += self._positions
            values += self._velocities
        if self._values["observation_noise"]:
            noise = self._generator.normal(0.0, self._values["observation_noise"], len(values)).tolist()
            values = [value + error for value, error in zip(values, noise, strict=True)]
        return values

    def pads_touching(self, body: Body) -> int:
        return sum(self.world.touching(self.body, body, link) for link in self._drives.pads)

    def towards(self, position: Vector, opening: float) -> FloatArray:
        values: list[float]
        if self._cartesian:
            away = [goal - now for goal, now in zip(position, self.tool_position, strict=True)]
            longest = max(1.0, max(abs(value) for value in away) / self.tool_step)
            values = [value / self.tool_step / longest for value in away]
            if self._yaws:
                heading = self._at.tool.x
                turn = self.home_yaw - atan2(heading[1], heading[0])
                values.append(atan2(sin(turn), cos(turn)) / self.settings.yaw_step)
        else:
            turns = self._turns_to(position, self.home_yaw)
            values = [turn / step for turn, step in zip(turns, self.joint_step, strict=True)]
        return self._action(values, opening)

    def turning(self, changes: Sequence[float], opening: float) -> FloatArray:
        if self._cartesian:
            raise UsageError(
                "cartesian control does not turn joints", where="robot.control", hint="set robot.control: joint"
            )
        return self._action([turn / step for turn, step in zip(changes, self.joint_step, strict=True)], opening)

    def _action(self, values: list[float], opening: float) -> FloatArray:
        if self._fingers is not None:
            values.append(2 * opening - 1)
        return np.clip(np.array(values, np.float32), -1, 1)
