"""What a robot is to the environment, and what a task may know of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol

from pydantic import BaseModel

from ...core import FloatArray, Layout
from ...core.seeding import Generator
from ...randomization.parameter import Parameter
from ..body import Body, Vector
from ..kinematics import Configuration
from ..world import World
from .box import Box


@dataclass(frozen=True)
class Gripper:
    """A parallel gripper with friction pads."""

    width: float
    """Between the pads when open, in m."""
    force: float
    """With which each finger closes, in N."""
    speed: float
    """Of each finger, in m/s."""
    pad_friction: float
    """Lateral friction coefficient of the pads."""


@dataclass(frozen=True)
class JointLimits:
    """Of the arm's joints: positions in rad, speed in rad/s, torque in N m."""

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    velocity: tuple[float, ...]
    effort: tuple[float, ...]


class RobotView(Protocol):
    """All that a task, or a scripted expert, may know of a robot."""

    @property
    def workspace(self) -> Box:
        """Where the tool can be while it points down: every point within 5 mm."""

    @property
    def limits(self) -> JointLimits: ...

    @property
    def gripper(self) -> Gripper | None:
        """None: the robot has no gripper, and no task that grasps."""

    @property
    def home(self) -> Vector:
        """Where the tool is at the start of an episode, but for the reset noise, in m."""

    @property
    def home_yaw(self) -> float:
        """Of the tool's x axis about the vertical at home, in rad; the pads face each other along the tool's x or y."""

    @property
    def reset_noise(self) -> float:
        """Largest deviation of each joint from the home pose at a reset, in rad."""

    @property
    def tool_step(self) -> float:
        """Largest way of the tool along each axis in one control step, in m."""

    @property
    def joint_step(self) -> tuple[float, ...]:
        """Largest turn of each joint in one control step, in rad."""

    @property
    def period(self) -> float:
        """Seconds of a control step."""

    @property
    def turns_joints(self) -> bool:
        """Whether actions can turn each joint by itself, so that `turning` works."""

    @property
    def home_joints(self) -> tuple[float, ...]:
        """Joint positions of the home pose in rad: (n,)."""

    @property
    def joint_positions(self) -> Sequence[float]:
        """Now, in rad: (n,)."""

    @property
    def joint_velocities(self) -> Sequence[float]:
        """Now, in rad/s: (n,)."""

    def forward(self, joints: Sequence[float]) -> Configuration:
        """Where the tool and each joint with its axis are when the joints are at positions (n,) in rad."""

    @property
    def tool_position(self) -> Vector:
        """Tool centre point now, in m."""

    @property
    def tool_velocity(self) -> Vector:
        """In m/s."""

    @property
    def opening(self) -> float:
        """Of the gripper, in [0, 1]: 0 closed, 1 open. 0 where there is none or the task does without."""

    def pads_touching(self, body: Body) -> int:
        """How many of the two pads are in contact with the body."""

    def place_tool(self, position: Vector, opening: float) -> None:
        """At a reset: put the tool there at rest, pointing down. Raises PluginError where it cannot be."""

    def towards(self, position: Vector, opening: float) -> FloatArray:
        """The action (action.size,) that moves the tool towards `position` and the gripper to `opening`."""

    def turning(self, changes: Sequence[float], opening: float) -> FloatArray:
        """The action (action.size,) that turns the joints by `changes` (n,) in rad, each cut at its largest step.

        Raises UsageError where actions do not turn joints.
        """


class Robot(RobotView, Protocol):
    """A robot plugin: built from its settings, light; `build` puts it into a world.

    The order of calls: `prepare`, then the layouts; `build` once; per episode `apply` and `reset`; per step `act`, a
    physics step, `read`.
    """

    Settings: ClassVar[type[BaseModel]]

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """What domain randomization may change, by name."""

    @property
    def observation(self) -> Layout: ...

    @property
    def action(self) -> Layout: ...

    def prepare(self, *, gripper: bool, period: float, points_down: bool = True) -> None:
        """Learn whether the task moves the gripper, and the seconds of a control step, in which largest steps count.

        Args:
            points_down: whether the task is done with the tool pointing down; where not, joints are what actions turn
                unless the settings say otherwise.

        Raises PluginError when the task needs a gripper and there is none.
        """

    def build(self, world: World) -> None: ...

    def apply(self, name: str, value: float) -> None:
        """Set a declared parameter for the coming episode; called before `reset`."""

    def reset(self, generator: Generator) -> None:
        """Take the home pose, but for the reset noise, and `read`. The generator is the episode's, to keep."""

    def act(self, action: Sequence[float]) -> None:
        """Aim the motors: action.size finite numbers, clipped to [-1, 1]."""

    def read(self) -> None:
        """Take the state from the world: what the view and `observe` then give."""

    def observe(self) -> list[float]:
        """The robot's part of the observation."""
