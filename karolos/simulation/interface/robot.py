"""What a robot is to the environment, and what a task may know of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol

from pydantic import BaseModel

from ...core import FloatArray, Generator, Layout, Measure
from ...randomization.randomization import RandomizedParameter
from ..geometry import Box, Orientations, Quaternion, Vector
from ..kinematics import Configuration, Pose
from .engine import Ability, Body, Cup, Gripper, JointLimits, World

GripperUse = bool | Literal["closed"]
ControlMode = Literal["joint", "cartesian", "pose", "impedance"]


@dataclass(frozen=True)
class TaskNeeds:
    """What a task asks of a robot."""

    gripper: GripperUse
    """Whether it uses the gripper, see `Task.uses_gripper`."""
    period: float
    """Duration of a control step in s."""
    control: ControlMode = "cartesian"
    """What actions change unless the robot's settings say otherwise, see `Task.control`."""
    protective_stop: bool = False
    """Whether the robot stops protectively unless its settings say otherwise."""
    fingers: float = 0.0
    """How far a gripper that the task does not use stands open unless the robot's settings say otherwise."""


class RobotView(Protocol):
    """Everything that a task or a scripted expert may know of a robot."""

    base: Vector
    """Position of its base in the world, in m."""
    workspace: Box
    """Region that the tool reaches while it points down, each point to within 5 mm."""
    orientations: Orientations
    """Those to which actions turn the tool, around that of home."""
    dexterous: Box | None
    """Part of the workspace in which the tool takes all of them; None where it is not known."""
    limits: JointLimits
    gripper: Gripper | Cup | None
    """None for a robot without a gripper."""
    gripper_delay: float
    """Seconds after which the gripper follows its command, where randomization draws no other delay."""
    home: Vector
    """Tool position at the start of an episode without reset noise, in m."""
    home_yaw: float
    """Yaw of the tool's x axis at home, in rad. The pads face each other along the tool's x or y axis."""
    reset_noise: float
    """Largest deviation of each joint from the home pose at a reset, in rad."""
    tool_step: float
    """Largest change of the tool position along each axis in one control step, in m."""
    tool_speed: float
    """Largest speed of the tool centre point in m/s; inf where the speeds of the joints alone limit it."""
    joint_step: tuple[float, ...]
    """Largest change of each joint position in one control step, in rad: (n,)."""
    period: float
    """Duration of a control step in s."""
    turns_joints: bool
    """Whether actions change joint positions, so that `turning` works."""
    home_joints: tuple[float, ...]
    """Joint positions of the home pose in rad: (n,)."""
    joint_positions: Sequence[float]
    """Current joint positions in rad: (n,)."""
    joint_velocities: Sequence[float]
    """Current joint velocities in rad/s: (n,)."""

    tool: Pose
    """Current pose of the tool."""
    closing: Vector
    """Direction in which the pads close, of either of them; only with a gripper that the task uses."""
    tool_position: Vector
    """Current position of the tool centre point, in m."""
    tool_velocity: Vector
    """Current velocity of the tool centre point, in m/s."""
    opening: float
    """Opening of the gripper: 0 closed, 1 open. 0 without a gripper or when the task does not use it."""
    opening_command: float
    """Opening that the gripper was told to take: 0 closed, 1 open. 0 without a gripper."""
    observed_tool_position: Vector
    """The tool position in m as the last `observe` gave it, with noise."""

    def forward(self, joints: Sequence[float]) -> Configuration:
        """Forward kinematics: tool pose and joint axes at joint positions (n,) in rad."""

    stopped: bool
    """Whether a protective stop has ended the running episode."""

    wrench: Sequence[float]
    """What contacts do to the gripper and what it holds, as a sensor at the wrist feels it: force in N and torque in
    N m at the tool centre point, in the tool's frame, low-passed; zero at a reset."""
    joint_torques: Sequence[float]
    """Of the motors in the last physics step, in N m: (n,)."""

    def contact_force(self, body: Body) -> float:
        """Largest force in N of a body on the links in a physics step of the last control step."""

    def largest_force(self, *allowed: Body) -> float:
        """Largest force in N on a link in a physics step of the last control step, by other bodies than these."""

    def touches_others(self, *allowed: Body) -> bool:
        """Whether anything but these bodies presses on a link: the floor, another body, or another link of the arm."""

    def with_noise(self, values: Sequence[float]) -> list[float]:
        """The values with the observation noise of the episode, for what a task observes of its objects."""

    def pads_touching(self, body: Body) -> int:
        """Number of pads (0, 1, 2) in contact with the body; 2 for one that a cup holds."""

    def pads_gripping(self, body: Body) -> int:
        """Number of pads (0, 1, 2) whose inner faces, facing each other, touch the body; 2 for one that a cup holds."""

    def place_tool(
        self, position: Vector, opening: float, *, orientation: Quaternion | None = None, closing: bool = False
    ) -> None:
        """During a reset: put the tool there at rest, the gripper at `opening`.

        Args:
            position: in m.
            opening: 0 closed, 1 open.
            orientation: of the tool; None: pointing down as at home.
            closing: whether the gripper closes until an action says otherwise, to hold what is between its pads.

        Raises PluginError for an unreachable position.
        """

    def towards(self, position: Vector, opening: float, orientation: Quaternion | None = None) -> FloatArray:
        """The action (action.size,) that moves the tool towards a pose and the gripper to `opening`.

        The orientation of the tool is by default that of home.
        """

    def turning(self, changes: Sequence[float], opening: float) -> FloatArray:
        """The action (action.size,) that changes the joints by `changes` (n,) in rad, clipped to the joint step.

        Raises UsageError when actions do not change joint positions.
        """


class Robot(RobotView, Protocol):
    """A robot plugin. Its constructor takes the settings and is cheap; `build` adds the robot to a world.

    Order of calls: `prepare`, then the layouts; `build` once; per episode `apply` and `reset`; per step `act`, a
    physics step, `read`.
    """

    Settings: ClassVar[type[BaseModel]]

    parameters: Mapping[str, RandomizedParameter]
    """What domain randomization may change, by name."""
    observation: Layout
    action: Layout
    stops: int
    """Number of protective stops in the running episode, those that are only counted included."""
    measures: Sequence[Measure]
    """What it measures an episode by; may depend on `prepare`."""

    engine_needs: Mapping[str, Ability]
    """What not every engine can do and it needs, by the setting that asks for it, as a spec calls it."""

    def prepare(self, needs: TaskNeeds) -> None:
        """Adapt layouts and step sizes to a task.

        Raises PluginError when the task needs a gripper and the robot has none, UsageError when its settings contradict
        the task.
        """

    def build(self, world: World) -> None: ...

    def apply(self, name: str, value: float) -> None:
        """Set a declared parameter for the next episode; called before `reset`."""

    def reset(self, generator: Generator) -> None:
        """Take the home pose with reset noise, then `read`. The generator belongs to the episode and may be stored."""

    def act(self, action: Sequence[float]) -> None:
        """Aim the motors: action.size finite numbers, clipped to [-1, 1]."""

    def read(self) -> None:
        """Read the state from the world, for the view and `observe`."""

    def observe(self) -> list[float]:
        """The robot's part of the observation."""

    def measure(self) -> dict[str, float]:
        """The values of `measures` at the end of an episode, by name; as `Task.measure`."""
