"""What a task is to the environment."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from pydantic import BaseModel

from ...core import Expert, FloatArray, Generator, GoalRule, Layout, Measure
from ...randomization.randomization import RandomizedParameter, drawn_settings
from .engine import FLOOR_FRICTION, GRAVITY, Ability, Camera, Stroke, World
from .robot import ControlMode, GripperUse, RobotView

FINAL_DISTANCE = Measure("final_distance", "m", "smaller", "distance from the goal at the end of the episode")


class Task(ABC):
    """A task plugin: the objects in the world, the goal and its rule. Its settings have `max_steps`.

    Order of calls: `fit` (sets `goal_rule` and the layouts that depend on the robot), `build` once; per episode `reset`
    after the robot's; per step `read` after the robot's, then `observe`, `lost`, `achieved`.
    The docstring of a task has these headings: What to do, What is randomised, Observation, Action, Goals, Reward, What
    counts as success, Termination.
    """

    Settings: ClassVar[type[BaseModel]]
    settings: Any
    """As the spec has them."""
    drawn: Any
    """The same in the running episode: a setting that is marked with `Drawn` has the value that training drew."""
    uses_gripper: ClassVar[GripperUse]
    """Whether the action moves the gripper. If not, its fingers stand still and are not simulated. "closed": it stays
    closed around what the task puts between its fingers, and no action opens it."""
    fingers: ClassVar[float] = 0.0
    """How far they stand open then if the robot's settings do not say: 0 closed, 1 open."""
    control: ClassVar[ControlMode] = "cartesian"
    """What the actions of a robot change if its settings do not say: joint positions (joint), the position of a tool
    that points down (cartesian), its whole pose (pose), or that of a spring that moves the tool (impedance)."""
    protective_stop: ClassVar[bool] = True
    """Whether a robot stops protectively if its settings do not say; a stop ends the episode without success."""
    camera: Camera = Camera()
    """Where pictures are taken from if the arm stands at the origin. Nothing that moves leaves the picture."""
    observation: Layout = Layout()
    """The task's part of the observation, without the goals; may depend on the settings."""
    critic_only: ClassVar[Layout] = Layout()
    """What critics may observe besides, and no policy: a spec chooses from it by `environment.critic_observes`."""
    extra_reward_range: tuple[float, float] = (0.0, 0.0)
    """Smallest and largest `extra_reward`."""
    achieved_goal: Layout
    desired_goal: Layout
    measures: ClassVar[tuple[Measure, ...]] = ()
    """What an episode is measured by, besides what the environment adds for every robot and goal rule."""
    distance_measure: ClassVar[Measure] = FINAL_DISTANCE
    """What the goal rule's distance at the end of an episode is called, if the rule has one."""

    goal: FloatArray
    """The goal of the running episode: (desired_goal.size,)."""
    goal_rule: GoalRule

    def __init__(self, settings: Any) -> None:
        self.settings = self.drawn = settings
        self.goal = np.zeros(self.desired_goal.size, np.float32)

    @property
    def engine_needs(self) -> Mapping[str, Ability]:
        """What not every engine can do and this task needs, by the setting that asks for it, as a spec calls it."""
        return {}

    @property
    def max_steps(self) -> int:
        """Control steps per episode."""
        return int(self.settings.max_steps)

    @abstractmethod
    def fit(self, robot: RobotView) -> None:
        """Check the settings against the robot. Raises UsageError when the two are incompatible."""

    def build(self, world: World) -> None:  # noqa: B027 (a task may have no objects)
        """Add objects and markers to the world."""

    @abstractmethod
    def reset(self, generator: Generator) -> None:
        """Place objects and an unsolved goal. Raises RunError when no such goal is found."""

    def read(self) -> None:  # noqa: B027 (a task may have no objects)
        """Read the state of the objects from the world after a physics step."""

    def observe(self) -> list[float]:
        """The task's part of the observation."""
        return []

    def observe_for_critics(self) -> list[float]:
        """The numbers of `critic_only`."""
        return []

    def extra_reward(self) -> float:
        """What is added to the goal rule's reward of this step, whatever the goal: hindsight keeps it as it is."""
        return 0.0

    @abstractmethod
    def achieved(self) -> FloatArray:
        """The achieved goal (achieved_goal.size,), a new array."""

    def measure(self) -> dict[str, float]:
        """The values of `measures` at the end of an episode, by name; one that is left out or not finite is undefined.

        Called after `read`, if the physics has not diverged.
        """
        return {}

    def expert(self) -> Expert | None:
        """A scripted policy, or None for a task without one. Called after `build`."""
        return None

    def strokes(self) -> Sequence[Stroke]:
        """Lines and arrows that a picture shows besides bodies and markers. Called for each picture, after `read`."""
        return ()

    def lost(self) -> bool:
        """Whether the physics diverged, e.g. an object is far away: the episode is truncated."""
        return False

    def over(self) -> bool:
        """Whether the arm can change nothing any more: the episode is truncated.

        A parameter that training draws should decide it, so that tests play on.
        """
        return False

    @property
    def parameters(self) -> Mapping[str, RandomizedParameter]:
        """What domain randomization may change, by name: the world, and settings that are marked with `Drawn`."""
        return {**WORLD_PARAMETERS, **drawn_settings(self.settings)}

    def apply(self, world: World, name: str, value: float) -> None:
        """Set a parameter for the next episode; called before `reset`. Settings are read from `drawn`."""
        if name == "gravity":
            world.set_gravity(value)
        elif name == "floor_friction":
            world.set_floor_friction(value)
        else:
            self.drawn = self.drawn.model_copy(update={name: value})


WORLD_PARAMETERS: Mapping[str, RandomizedParameter] = {
    "gravity": RandomizedParameter("m/s2", GRAVITY, -20.0, 0.0, "along z"),
    "floor_friction": RandomizedParameter("1", FLOOR_FRICTION, 0.0, 5.0, "lateral friction coefficient of the floor"),
}
