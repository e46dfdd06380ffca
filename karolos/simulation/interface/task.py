"""What a task is to the environment, and the scripted expert that shows how it is done."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar

from pydantic import BaseModel

from ...core import FloatArray, GoalRule, Layout
from ...core.seeding import Generator
from ...randomization.parameter import Parameter
from ..camera import Camera
from ..world import FLOOR_FRICTION, GRAVITY, World
from .robot import RobotView


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
