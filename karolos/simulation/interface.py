"""What robots and tasks are to each other and to the environment that joins them.

A robot and a task do not know each other: the task speaks to `RobotView` and nothing else, so any robot goes with any
task. Importing this needs no pybullet; a world is built when an environment is reset for the first time.
Units: m, s, kg, N, rad; float32 arrays; the world's frame has its origin at the robot's base, on the floor.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol

from pydantic import BaseModel

from ..core import FloatArray, GoalRule, Layout
from ..randomization.parameter import Parameter
from ..seeding import Generator
from .body import Body, Vector
from .camera import Camera
from .kinematics import Configuration
from .world import FLOOR_FRICTION, GRAVITY, World


@dataclass(frozen=True)
class Box:
    """An axis-aligned box in m."""

    low: Vector
    high: Vector

    @property
    def centre(self) -> Vector:
        (a, b, c), (d, e, f) = self.low, self.high
        return (a + d) / 2, (b + e) / 2, (c + f) / 2

    @property
    def diagonal(self) -> float:
        """Length in m."""
        return float(sum((high - low) ** 2 for low, high in zip(self.low, self.high, strict=True)) ** 0.5)

    def contains(self, point: Sequence[float], margin: float = 0.0) -> bool:
        return all(
            low - margin <= value <= high + margin for low, value, high in zip(self.low, point, self.high, strict=True)
        )

    def middle(self, edges: Vector) -> Box:
        """The box of these edge lengths in the middle of this one, never larger than it."""
        half = [min(edge, high - low) / 2 for edge, low, high in zip(edges, self.low, self.high, strict=True)]
        (x, y, z), (a, b, c) = self.centre, half
        return Box((x - a, y - b, z - c), (x + a, y + b, z + c))


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


class Expert(ABC):
    """A scripted policy for one task: it shows that a pair can be solved, and gives demonstrations.

    Written against the robot's view, for any robot and any control mode. The order of calls: `reset` after the
    environment's reset, then `act` before each step.
    """

    @abstractmethod
    def reset(self) -> None:
        """A new episode has begun."""

    @abstractmethod
    def act(self) -> FloatArray:
        """The next action: (action.size,)."""


class Task(ABC):
    """A task plugin: what stands in the world besides the robot, the goal, and when it is reached.

    The order of calls: `fit` (sets `goal_rule` and the layouts that depend on the robot), `build` once; per episode
    `reset` after the robot's; per step `read` after the robot's, then `observe`, `lost`, `achieved`.
    The docstring of a task says under these headings: What to do, What is randomised, What counts as success.
    """

    Settings: ClassVar[type[BaseModel]]
    uses_gripper: ClassVar[bool]
    """Whether the action moves the gripper. Where not, it stays closed and costs nothing."""
    points_down: ClassVar[bool] = True
    """Whether the task is done with the tool pointing down, which is how cartesian control moves it."""
    camera: ClassVar[Camera] = Camera()
    """Where pictures are taken from."""
    observation: ClassVar[Layout]
    """The task's part of the observation; goals are not part of it."""
    achieved_goal: Layout
    desired_goal: Layout

    goal: FloatArray
    """The goal of the running episode: (desired_goal.size,)."""
    goal_rule: GoalRule

    @property
    @abstractmethod
    def max_steps(self) -> int: ...

    @abstractmethod
    def fit(self, robot: RobotView) -> None:
        """Check the settings against the robot. Raises UsageError when the two do not go together."""

    @abstractmethod
    def build(self, world: World) -> None: ...

    @abstractmethod
    def reset(self, generator: Generator) -> None:
        """Place objects and goal; the goal must not hold. Raises RunError when none is found."""

    def read(self) -> None:  # noqa: B027 (a task without objects has nothing to read)
        """Take the state of the objects from the world after a physics step."""

    @abstractmethod
    def observe(self) -> list[float]:
        """The task's part of the observation."""

    @abstractmethod
    def achieved(self) -> FloatArray:
        """(achieved_goal.size,): a new array."""

    def expert(self) -> Expert | None:
        """A scripted policy for the running environment; None: the task has none. Called after `build`."""
        return None

    def lost(self) -> bool:
        """Whether the world has left all sense (an object far away): the episode is truncated."""
        return False

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """What domain randomization may change, by name. A task adds its own."""
        return WORLD_PARAMETERS

    def apply(self, world: World, name: str, value: float) -> None:
        """Set a declared parameter for the coming episode; called before `reset`."""
        if name == "gravity":
            world.set_gravity(value)
        elif name == "floor_friction":
            world.set_floor_friction(value)
        else:
            raise KeyError(name)


WORLD_PARAMETERS: Mapping[str, Parameter] = {
    "gravity": Parameter("m/s2", GRAVITY, -30.0, 0.0, "along z"),
    "floor_friction": Parameter("1", FLOOR_FRICTION, 0.0, 5.0, "lateral friction coefficient of the floor"),
}
