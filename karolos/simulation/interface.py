"""The interfaces between an engine, a robot, a task and the environment that joins them.

A task uses only the `RobotView` of a robot, so any robot works with any task. Robots and tasks use only `World`,
`Body` and `Motors` of an engine.
Units: m, s, kg, N, rad. The world's frame has its origin on the floor, at the robot's base or, with `robot.base:
centred`, below the middle of its workspace.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final, Literal, NamedTuple, Protocol

import numpy as np
from pydantic import BaseModel

from ..core import Array, Expert, FloatArray, Generator, GoalRule, Layout, Measure
from ..core.parameters import RandomizedParameter, drawn_settings
from .geometry import UPRIGHT, Colour, Orientations, Quaternion, Vector
from .geometry import Box as Box  # noqa: PLC0414  (plugins import it from here)
from .kinematics import Configuration, Numbers, Pose
from .parts import Mechanism
from .shapes import Inertia, Shape

Ability = Literal["impedance", "suction", "materials", "window"]
"""An ability that not every engine has: springs at tools, cups, surfaces of given stiffness, a window."""
PHYSICS_RATE: Final = 240
"""Default number of physics steps per second."""
GRAVITY = -9.81
"""Gravity along z in m/s2."""
FLOOR_FRICTION = 0.5
"""Lateral friction coefficient of the floor. A contact has the product of the coefficients of its two bodies."""
OPENS = 0.01
"""The gripper opens while its commanded opening (0 to 1) is larger than the measured one by more than this."""
FINGER_RATE = 24.0
"""Speed in 1/s by which a finger closes the distance to its target."""


@dataclass(frozen=True)
class Camera:
    """Camera of a picture: `distance` m away from `target`, at angles in degrees."""

    target: Vector = (0.33, 0.0, 0.33)
    distance: float = 1.75
    yaw: float = 42.0
    pitch: float = -20.0
    field_of_view: float = 33.0
    base: Vector = (0.0, 0.0, 0.0)
    """Place of the arm. Pictures show a plate on the floor below it."""


class Stroke(NamedTuple):
    """A mark in a picture: a line through points in m, or an arrow from the first to the last."""

    points: Sequence[Vector]
    colour: Colour
    width: float = 1.0
    """Multiple of a usual line's width."""
    label: str | None = None
    """Label at the head of an arrow; None: a line, which bodies in front of it hide."""


@dataclass(frozen=True)
class JointLimits:
    """Limits of an arm's joints: positions in rad, speed in rad/s, torque in N m."""

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    velocity: tuple[float, ...]
    effort: tuple[float, ...]
    names: tuple[str, ...] = ()
    """Names of the joints, for messages; empty if they have none."""

    def name(self, joint: int) -> str:
        """The name of a joint in messages, given its index; its number from 1 if it has none."""
        return self.names[joint] if self.names else str(joint + 1)


@dataclass(frozen=True)
class Gripper:
    """A parallel gripper with friction pads."""

    width: float
    """Distance between the open pads, in m."""
    force: float
    """Closing force of each finger, in N."""
    speed: float
    """Speed of each finger, in m/s."""
    pad_friction: float
    """Lateral friction coefficient of the pads."""


@dataclass(frozen=True)
class Cup:
    """A suction cup. Its lip is a ring of spheres of the URDF, in the last link, around the tool centre point.

    Suction seals if all of them are near the same body. It presses the two together with its force. A larger pull opens
    the lip and releases the body. Along the lip friction holds, in proportion to the remaining pressure.
    """

    radius: float
    """Radius of the lip, in m."""
    max_force: float
    """Largest force of the suction, in N."""
    pad_friction: float
    """Lateral friction coefficient of the lip."""


@dataclass(frozen=True)
class Material:
    """Stiffness of a body's surface. Two bodies that touch are two springs in series, and two dampers.

    PyBullet's contacts are as stiff as its solver allows.
    """

    stiffness: float = 4e6
    """Stiffness of each contact point in N/m. The default holds an arm that presses on the floor with 1 kN."""
    damping: float = 0.0
    """Damping of each contact point in N s/m."""
    restitution: float = 0.0
    """Speed after an impact / speed before it, in [0, 1]. The larger value of the two bodies counts."""


OBJECT_MATERIAL = Material(stiffness=4e5)
"""Default of free bodies and of moving links of mechanisms."""


Frame = tuple[Vector, Quaternion]
"""Position in m and orientation."""


class Spring(NamedTuple):
    """A spring and damper between a tool and its set point: F = K e - D v, up to the torques of the joints.

    The weight of the arm is compensated. D follows from K and from the mass of the tool at home, for each direction.
    """

    stiffness: float
    """Stiffness in N/m."""
    turn_stiffness: float
    """Rotational stiffness in N m/rad."""
    damping_ratio: float
    """Damping ratio; 1: critical damping, the tool does not swing."""
    error: float
    """Largest distance e to the set point that the spring uses, in m. A larger distance gives the same force."""
    turn_error: float
    """The same for the rotation, in rad."""
    home: tuple[float, ...]
    """Joint positions in rad to which a redundant arm returns."""


@dataclass(frozen=True)
class Fingers:
    """Two prismatic joints of a URDF that move as one."""

    joints: tuple[str, str]
    links: tuple[str, str]
    travel: float
    """Travel of each finger, in m."""
    open_at_zero: bool
    """Whether joint position 0 means open; otherwise it means closed."""
    gripper: Gripper

    def position(self, opening: float) -> float:
        """Joint position in m for an opening in [0, 1]."""
        return self.travel * (1 - opening if self.open_at_zero else opening)

    def opening(self, position: float) -> float:
        """Opening in [0, 1] for a joint position in m."""
        fraction = position / self.travel
        return 1 - fraction if self.open_at_zero else fraction


class LinkState(NamedTuple):
    """Frame of a link (m, quaternion), velocity of its centre of mass (m/s), angular velocity (rad/s), that centre."""

    position: Vector
    orientation: Quaternion
    velocity: Vector
    angular_velocity: Vector
    centre: Vector


class Contact(NamedTuple):
    """A point at which two bodies touch."""

    normal: Vector
    """Unit vector from the second body to the first."""
    force: float
    """Normal force in N, of the last physics step."""
    distance: float
    """Distance of the two surfaces in m; negative if they overlap."""


class Body(Protocol):
    """One body of a world. A link has the index of the joint above it; -1 is the base."""

    index: int
    """Index of the body in its world."""

    def links(self) -> dict[str, int]:
        """Index of each link by name, without the base."""

    def collide_only(self, pairs: Collection[tuple[int, int]]) -> None:
        """Enable collisions between these pairs of the body's links, and between no others of this body."""

    def place(self, position: Vector, orientation: Quaternion = UPRIGHT) -> None:
        """Set the pose of the base, at rest."""

    def pose(self) -> tuple[Vector, Quaternion]:
        """Position (m) and orientation of the base."""

    def velocity(self) -> tuple[Vector, Vector]:
        """Linear (m/s) velocity of the origin of the base's frame, and angular velocity (rad/s) of the base."""

    def set_velocity(self, velocity: Vector) -> None:
        """Set the velocity of a free base in m/s, without spin."""

    def link(self, link: int) -> LinkState:
        """State of a link, computed from the joints."""

    def joints(self, joints: Sequence[int]) -> tuple[tuple[float, float, Any, float], ...]:
        """For each joint its position (rad or m), velocity (per s), reaction forces and motor torque (N m or N)."""

    def joint(self, name: str) -> tuple[float, float]:
        """Position (rad or m) and velocity (per s) of a mechanism's joint."""

    def place_joint(self, name: str, position: float) -> None:
        """Place a mechanism's joint there at rest."""

    def drive_joint(self, name: str, speed: float, force: float) -> None:
        """Drive a mechanism's joint at a speed (per s) with at most this force (N or N m). Speed 0 is dry friction."""

    def set_joint_damping(self, name: str, damping: float) -> None:
        """Set the viscous friction of a mechanism's joint in N s/m or N m s/rad."""

    def set_friction(self, lateral: float, link: int = -1) -> None:
        """Set the lateral friction coefficient of a link."""

    def set_material(self, material: Material, link: int = -1) -> None:
        """Set the stiffness of a link's surface. Raises UsageError if the engine cannot."""

    def set_inertia(self, mass: float, diagonal: Vector, link: int = -1) -> None:
        """Set the mass in kg and the principal moments in kg m2 of a link. Its centre of mass and axes stay."""


class Loads(NamedTuple):
    """The largest values of each joint of an arm since its positions were last written: (n,) each."""

    speed: Sequence[float]
    """Speed in rad/s."""
    acceleration: Sequence[float]
    """Acceleration in rad/s2, the mean of a control step."""
    torque: Sequence[float]
    """Torque of the motor, in N m."""
    wrench: float
    """The largest force of `Motors.wrench` since then, in N; with PyBullet as for `World.largest_forces`."""


class Motors(Protocol):
    """The motors of an arm and its gripper.

    Each motor of the arm follows a target speed with the necessary torque, up to its largest torque. The gripper closes
    or opens at its speed, each finger with at most its force.
    """

    pads: Sequence[int]
    """Links of the gripper's pads; empty without a gripper of fingers."""

    def holds(self, body: Body | None = None) -> bool:
        """Whether the suction of a cup holds this body, or anything; False without a cup."""

    def set_joint_friction(self, fraction: float) -> None:
        """Set the dry friction of the arm's joints: the fraction of its largest torque that each motor loses to it."""

    def set_joint_damping(self, damping: float) -> None:
        """Set the viscous friction of the arm's joints in N m s/rad, in addition to that of the URDF."""

    def set_gain(self, factor: float) -> None:
        """Set the fraction of a difference from the target speed that a motor removes in 1/240 s, in (0, 1]."""

    def set_mass(self, factor: float) -> None:
        """Scale the masses and inertias of all moving links."""

    def set_pad_friction(self, friction: float) -> None:
        """Set the lateral friction coefficient of the pads, or of the lip."""

    def attach(self, spring: Spring) -> None:
        """Let a spring move the tool from now on, in place of target speeds. Raises UsageError if the engine cannot.

        Dry friction then brakes the joints.
        """

    def aim(self, position: Vector, orientation: Quaternion, velocity: Vector, spin: Vector) -> None:
        """Set the set point of the spring in m, and how it moves in the next control step, in m/s and rad/s."""

    def wrench(self) -> Sequence[float]:
        """The wrench of contacts on the tool and its load: force in N and torque in N m at the tool, in its frame.

        Low-passed, and zero at a reset. A held body counts with its weight and inertia, the gripper itself does not. A
        sensor at the wrist measures the same if its own load is compensated. In PyBullet from the first call on.
        """

    def set_wrench_filter(self, seconds: float) -> None:
        """Set the time constant in s of the wrench's low-pass, before the first step; 0: none."""

    def write(self, positions: Numbers, opening: float) -> None:
        """Place the joints (n,) in rad and the gripper there at rest; the motors hold the arm still."""

    def drive(self, ramp: Array, openings: Mapping[int, float]) -> None:
        """Set the target speeds of the next control step: a ramp from the first to the second row (2, n) in rad/s.

        After k of n physics steps a joint's target speed is begin + k / n (end - begin). `openings` of the gripper, in
        [0, 1], by the physics step of the control step in which each takes effect, from 0. Until then the gripper
        follows its last command. A cup sucks while its opening is below .5.
        """

    def read(self) -> tuple[Array, Array, float]:
        """Positions (n,) in rad and velocities (n,) in rad/s of the joints, opening of the gripper (0 without).

        For a cup: 1 without suction, .5 while it holds something (like fingers around an object), else 0.
        """

    def loads(self) -> Loads:
        """The largest speed, acceleration and torque of each joint since `write`.

        Speeds and torques are those of physics steps; in PyBullet those at the ends of control steps.
        """


class World(Protocol):
    """A floor, gravity and the added bodies. Built once: an episode begins by writing states, never by loading.

    A control step is `substeps` physics steps and takes `period` seconds.
    """

    substeps: int
    period: float
    lead: float
    """Time in s by which the world's velocities are later than its positions."""

    def step(self) -> None:
        """Simulate one control step."""

    def set_gravity(self, gravity: float) -> None:
        """Set gravity along z in m/s2; negative pulls down."""

    def set_floor_friction(self, friction: float) -> None:
        """Set the lateral friction coefficient of the floor."""

    def load(self, source: Path | Mechanism, *, position: Vector = (0.0, 0.0, 0.0)) -> Body:
        """Add a mechanism, from code, URDF or MJCF (`fixtures.read`). Its links do not collide with each other.

        The base is fixed, `place` moves it. Raises PluginError when the file or the engine refuses it.
        """

    def motors(
        self,
        body: Body,
        joints: Sequence[str],
        limits: JointLimits,
        fingers: Fingers | None,
        tool: Frame | None = None,
        cup: Cup | None = None,
    ) -> Motors:
        """The motors of a loaded arm.

        Args:
            joints: the links that its joints move, from base to wrist.
            tool: its frame in the last of these links; springs, the wrench and a cup need it.
            cup: replaces fingers. Not in PyBullet.
        """

    def release_in_motion(self) -> None:
        """After `motors`: let objects leave a moving hand cleanly, so that similar throws land near each other.

        Deep contacts are corrected more slowly then.
        """

    def body(self, shapes: Sequence[Shape], mass: float, colour: Colour, inertia: Inertia | None = None) -> Body:
        """Add a body made of shapes, without air drag.

        Args:
            shapes: at least one; they may overlap.
            mass: in kg. With 0 it is static: it moves only by `place`, and collides only with moving bodies.
            inertia: by default that of a body with uniform density.
        """

    def marker(self, radius: float, colour: Colour) -> Body:
        """Add a translucent sphere that collides with nothing."""

    def forget_contacts(self) -> None:
        """Forget the contacts and impulses of free bodies, so that an episode does not depend on the one before."""

    def contacts(self, first: Body, second: Body, link: int) -> Sequence[Contact]:
        """The contact points between `link` of the first body and any link of the second."""

    def forces(self, body: Body) -> dict[tuple[int, int], float]:
        """The forces on a body: the largest total normal force in N in a physics step of the last control step.

        The key is the body's link and the index of the other body. If two links of the body touch, it is the body's own
        index, and both links have an entry. Forces that were always zero are left out.
        """

    def largest_forces(self, body: Body) -> dict[tuple[int, int], float]:
        """As `forces`, the largest since the joints of an arm were last written.

        In PyBullet those of the last physics step of each control step, unless `forces` has been called.
        """

    def render(
        self, width: int, height: int, camera: Camera, strokes: Sequence[Stroke] = (), back: float = 0.0
    ) -> Array:
        """A picture (height, width, 3) uint8.

        Args:
            strokes: lines and arrows, in addition to bodies and markers.
            back: fraction of the way back from now to the last picture that had `back` 0.
        """

    def close(self) -> None:
        """Free the world. A second call has no effect."""


GripperUse = bool | Literal["closed"]
ControlMode = Literal["joint", "cartesian", "pose", "impedance"]


@dataclass(frozen=True)
class TaskNeeds:
    """The demands of a task on a robot."""

    gripper: GripperUse
    """Whether the task uses the gripper, see `Task.uses_gripper`."""
    period: float
    """Duration of a control step in s."""
    control: ControlMode = "cartesian"
    """The default of the robot's control mode, see `Task.control`."""
    protective_stop: bool = False
    """Whether the robot stops protectively unless its settings say otherwise."""
    fingers: float = 0.0
    """Opening of a gripper that the task does not use, unless the robot's settings say otherwise."""


class RobotView(Protocol):
    """Everything that a task or a scripted expert may know about a robot."""

    base: Vector
    """Position of its base in the world, in m."""
    workspace: Box
    """Region that the tool reaches while it points down, each point to within 5 mm."""
    orientations: Orientations
    """Orientations to which actions can turn the tool, around the one at home."""
    dexterous: Box | None
    """Part of the workspace in which the tool reaches all these orientations; None if unknown."""
    limits: JointLimits
    gripper: Gripper | Cup | None
    """None for a robot without a gripper."""
    gripper_delay: float
    """Delay of the gripper after its command in s, unless randomization samples another one."""
    home: Vector
    """Tool position at the start of an episode without reset noise, in m."""
    home_yaw: float
    """Yaw of the tool's x axis at home, in rad. The pads face each other along the tool's x or y axis."""
    reset_noise: float
    """Largest deviation of each joint from the home pose at a reset, in rad."""
    tool_step: float
    """Largest change of the tool position along each axis in one control step, in m."""
    tool_speed: float
    """Largest speed of the tool centre point in m/s; inf if only the speeds of the joints limit it."""
    joint_step: tuple[float, ...]
    """Largest change of each joint position in one control step, in rad: (n,)."""
    period: float
    """Duration of a control step in s."""
    turns_joints: bool
    """Whether actions change joint positions, so that `turning` works."""
    home_joints: tuple[float, ...]
    """Joint positions of the home pose in rad: (n,)."""
    joint_positions: Array
    """Current joint positions in rad: (n,)."""
    joint_velocities: Array
    """Current joint velocities in rad/s: (n,)."""

    tool: Pose
    """Current pose of the tool."""
    closing: Vector
    """Direction in which one of the pads closes; only with a gripper that the task uses."""
    tool_position: Vector
    """Current position of the tool centre point, in m."""
    tool_velocity: Vector
    """Current velocity of the tool centre point, in m/s."""
    opening: float
    """Opening of the gripper: 0 closed, 1 open. 0 without a gripper or when the task does not use it."""
    opening_command: float
    """Commanded opening of the gripper: 0 closed, 1 open. 0 without a gripper."""
    observed_tool_position: Vector
    """The tool position in m from the last `observe`, with noise."""

    def forward(self, joints: Sequence[float]) -> Configuration:
        """Forward kinematics: tool pose and joint axes at joint positions (n,) in rad."""

    stopped: bool
    """Whether a protective stop has ended the running episode."""

    wrench: Sequence[float]
    """The wrench of contacts on the gripper and its load, as a sensor at the wrist measures it: force in N and torque
    in N m at the tool centre point, in the tool's frame, low-passed; zero at a reset."""
    joint_torques: Sequence[float]
    """Torques of the motors in the last physics step, in N m: (n,)."""

    def contact_force(self, body: Body) -> float:
        """Largest force in N of a body on the links in a physics step of the last control step."""

    def largest_force(self, *allowed: Body) -> float:
        """Largest force in N on a link in a physics step of the last control step, by other bodies than these."""

    def touches_others(self, *allowed: Body) -> bool:
        """Whether anything but these bodies presses on a link: floor, another body, or another link of the arm."""

    def with_noise(self, values: Sequence[float]) -> list[float]:
        """The values with the observation noise of the episode, for a task that observes its objects."""

    def pads_touching(self, body: Body) -> int:
        """Number of pads (0, 1, 2) in contact with the body; 2 if a cup holds the body."""

    def pads_gripping(self, body: Body) -> int:
        """Number of pads (0, 1, 2) whose inner faces, facing each other, touch the body; 2 if a cup holds the body."""

    def place_tool(
        self, position: Vector, opening: float, *, orientation: Quaternion | None = None, closing: bool = False
    ) -> None:
        """During a reset: place the tool there at rest, with the gripper at `opening`.

        Args:
            position: in m.
            opening: 0 closed, 1 open.
            orientation: of the tool; None: pointing down as at home.
            closing: whether the gripper closes until an action says otherwise, to hold the object between its pads.

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
    """The parameters that domain randomization may change, by name."""
    observation: Layout
    action: Layout
    stops: int
    """Number of protective stops in the running episode, including stops that are only counted."""
    measures: Sequence[Measure]
    """The robot's measures of an episode. They may depend on `prepare`."""

    engine_needs: Mapping[str, Ability]
    """The abilities that it needs of an engine, by the setting that asks for them, as a spec calls it."""

    def prepare(self, needs: TaskNeeds) -> None:
        """Adapt layouts and step sizes to a task.

        Raises UsageError when the task needs a gripper and the robot has none, or its settings contradict the task.
        """

    def build(self, world: World) -> None: ...

    def apply(self, name: str, value: float) -> None:
        """Set a declared parameter for the next episode; called before `reset`."""

    def reset(self, generator: Generator) -> None:
        """Go to the home pose with reset noise, then `read`. The generator belongs to the episode and may be stored."""

    def act(self, action: Sequence[float]) -> None:
        """Aim the motors: action.size finite numbers, clipped to [-1, 1]."""

    def read(self) -> None:
        """Read the state from the world, for the view and `observe`."""

    def observe(self) -> list[float]:
        """The robot's part of the observation."""

    def measure(self) -> dict[str, float]:
        """The values of `measures` at the end of an episode, by name; as `Task.measure`."""


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
    """Settings of the spec."""
    drawn: Any
    """The settings in the running episode: a setting marked with `Drawn` has the value that training sampled."""
    stage: str | None = None
    """The stage in which the running episode began. The settings `start_STAGE` are the stages' probabilities."""
    uses_gripper: ClassVar[GripperUse]
    """Whether the action moves the gripper. If not, its fingers stand still and are not simulated. "closed": it stays
    closed around the object that the task puts between its fingers, and no action opens it."""
    fingers: ClassVar[float] = 0.0
    """Opening of such fingers, if the robot's settings do not say: 0 closed, 1 open."""
    held_mass: float = 0.0
    """kg of what a gripper that stays closed holds: a robot's controller is told it as payload. Set in `fit`."""
    control: ClassVar[ControlMode] = "cartesian"
    """The default of the robot's control mode. Actions change joint positions (joint), the position of a tool that
    points down (cartesian), its whole pose (pose), or the set point of a spring that moves the tool (impedance)."""
    protective_stop: ClassVar[bool] = True
    """Whether a robot stops protectively if its settings do not say; a stop ends the episode without success."""
    camera: Camera = Camera()
    """Camera of pictures if the arm stands at the origin. All moving things stay in the picture."""
    observation: Layout = Layout()
    """The task's part of the observation, without the goals; may depend on the settings."""
    critic_only: ClassVar[Layout] = Layout()
    """More fields, only for critics. A spec chooses from them by `environment.critic_observes`."""
    fine_fields: ClassVar[Mapping[str, Sequence[tuple[str, int, float, float]]]] = {}
    """Fields that show another field more finely, for a robot's computer: a column is tanh((field[column] + offset) /
    scale), described by (field, column, offset, scale)."""
    extra_reward_range: tuple[float, float] = (0.0, 0.0)
    """Smallest and largest `extra_reward`."""
    achieved_goal: Layout
    desired_goal: Layout
    measures: ClassVar[tuple[Measure, ...]] = ()
    """The task's measures of an episode. The environment adds those of every robot and goal rule."""
    distance_measure: ClassVar[Measure] = FINAL_DISTANCE
    """The measure of the goal rule's distance at the end of an episode, if the rule has one."""

    goal: FloatArray
    """The goal of the running episode: (desired_goal.size,)."""
    goal_rule: GoalRule

    def __init__(self, settings: Any) -> None:
        self.settings = self.drawn = settings
        self.goal = np.zeros(self.desired_goal.size, np.float32)

    @property
    def engine_needs(self) -> Mapping[str, Ability]:
        """The abilities that it needs of an engine, by the setting that asks for them, as a spec calls it."""
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
        """The part of this step's reward that does not depend on the goal. Hindsight does not change it."""
        return 0.0

    @abstractmethod
    def achieved(self) -> FloatArray:
        """The achieved goal (achieved_goal.size,), a new array."""

    def measure(self) -> dict[str, float]:
        """The values of `measures` at the end of an episode, by name. A missing or non-finite value is undefined.

        Called after `read`, if the physics has not diverged.
        """
        return {}

    def expert(self) -> Expert | None:
        """A scripted policy, or None for a task without one. Called after `build`."""
        return None

    def strokes(self) -> Sequence[Stroke]:
        """Lines and arrows of a picture, in addition to bodies and markers. Called for each picture, after `read`."""
        return ()

    def lost(self) -> bool:
        """Whether the physics diverged, e.g. an object is far away: the episode is truncated."""
        return False

    def over(self) -> bool:
        """Whether the arm can no longer change anything: the episode is truncated.

        A parameter that training samples should decide it, so that tests go on.
        """
        return False

    @property
    def parameters(self) -> Mapping[str, RandomizedParameter]:
        """The parameters that domain randomization may change: those of the world, and settings marked with `Drawn`."""
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
