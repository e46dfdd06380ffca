"""What a physics engine offers to robots and tasks: a world, its bodies and the motors of an arm.

Units: m, s, kg, N, rad; quaternions x y z w. z points up, the floor is z = 0.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from operator import gt
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, Protocol

from ...core import Array
from ..geometry import UPRIGHT, Colour, Quaternion, Vector
from ..parts import Mechanism
from ..shapes import Inertia, Shape

Ability = Literal["impedance", "suction", "materials", "window"]
"""What not every engine can do: springs at tools, cups, surfaces that give way as told, a window that shows a world."""
PHYSICS_RATE: Final = 240
"""Physics steps per second, if nothing else is said."""
GRAVITY = -9.81
"""m/s2 along z."""
FLOOR_FRICTION = 0.5
"""Lateral friction coefficient of the floor. A contact has the product of the coefficients of its two bodies."""
OPENS = 0.01
"""The gripper opens while its commanded opening (0 to 1) is larger than the measured one by more than this."""
FINGER_RATE = 24.0
"""Speed in 1/s by which a finger closes the distance to its target."""


@dataclass(frozen=True)
class Camera:
    """Where a picture is taken from: `distance` m away from `target`, at angles in degrees."""

    target: Vector = (0.33, 0.0, 0.33)
    distance: float = 1.75
    yaw: float = 42.0
    pitch: float = -20.0
    field_of_view: float = 33.0
    base: Vector = (0.0, 0.0, 0.0)
    """Where the arm stands: a plate is drawn on the floor below it."""


class Stroke(NamedTuple):
    """What a picture shows besides bodies: a line through points in m, or an arrow from the first to the last."""

    points: Sequence[Vector]
    colour: Colour
    width: float = 1.0
    """Of a usual line's width."""
    label: str | None = None
    """At the head of an arrow; None: a line, which bodies in front of it hide."""


@dataclass(frozen=True)
class JointLimits:
    """Limits of an arm's joints: positions in rad, speed in rad/s, torque in N m."""

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    velocity: tuple[float, ...]
    effort: tuple[float, ...]
    names: tuple[str, ...] = ()
    """Of the joints, for messages; empty where they have none."""

    def slowed(self, velocities: Sequence[float]) -> Sequence[float]:
        """The velocities (n,) with each joint at its largest speed at most."""
        if not any(map(gt, map(abs, velocities), self.velocity)):
            return velocities
        return [min(max(speed, -most), most) for speed, most in zip(velocities, self.velocity, strict=True)]

    def name(self, joint: int) -> str:
        """What a person calls a joint, given its index: its name, or its number from 1."""
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

    Suction seals where all of them are near the same body. It presses the two together with its force, whatever pulls:
    beyond it the lip opens, and lets go. Across the lip friction holds, as far as that leaves it pressed.
    """

    radius: float
    """Of the lip, in m."""
    max_force: float
    """Of the suction, in N."""
    pad_friction: float
    """Lateral friction coefficient of the lip."""


@dataclass(frozen=True)
class Material:
    """How the surface of a body gives way. Two bodies that touch are two springs in a row, and two dampers.

    PyBullet's contacts are as stiff as its solver can.
    """

    stiffness: float = 4e6
    """Of each point of contact, in N/m. The default is hard enough for an arm that presses on the floor with 1 kN."""
    damping: float = 0.0
    """Of each point of contact, in N s/m."""
    restitution: float = 0.0
    """Speed after an impact / speed before it, in [0, 1]; of two bodies that of the livelier."""


OBJECT_MATERIAL = Material(stiffness=4e5)
"""Of a free body and of what moves on a mechanism, if nothing else is said."""


Frame = tuple[Vector, Quaternion]
"""Position in m and orientation."""


class Spring(NamedTuple):
    """A spring and damper between a tool and its set point: F = K e - D v, up to the torques of the joints.

    The weight of the arm is compensated. D follows from K and from what the tool weighs at home, for each direction.
    """

    stiffness: float
    """N/m."""
    turn_stiffness: float
    """N m/rad."""
    damping_ratio: float
    """1: as much damping as the tool needs not to swing."""
    error: float
    """Largest distance e to the set point, in m, that the spring answers to: more does not pull more."""
    turn_error: float
    """The same of the rotation, in rad."""
    home: tuple[float, ...]
    """Joint positions in rad to which an arm with joints to spare returns meanwhile."""


@dataclass(frozen=True)
class Fingers:
    """Two prismatic joints of a URDF that move as one."""

    joints: tuple[str, str]
    links: tuple[str, str]
    travel: float
    """Of each finger, in m."""
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
    """Between the two surfaces in m; negative where they overlap."""


class Body(Protocol):
    """One body of a world. Links have an index, which is that of the joint above them; -1 is the base."""

    index: int
    """Of the body in its world."""

    def links(self) -> dict[str, int]:
        """Index of each link by name, without the base."""

    def collide_only(self, pairs: Collection[tuple[int, int]]) -> None:
        """Enable collisions between these pairs of the body's links, and between no others of this body."""

    def place(self, position: Vector, orientation: Quaternion = UPRIGHT) -> None:
        """Set the pose of the base, at rest."""

    def pose(self) -> tuple[Vector, Quaternion]:
        """Of the base."""

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
        """Put a mechanism's joint there at rest."""

    def drive_joint(self, name: str, speed: float, force: float) -> None:
        """Let a mechanism's joint go at a speed (per s) with at most this force (N or N m). Speed 0 is dry friction."""

    def set_joint_damping(self, name: str, damping: float) -> None:
        """Set the viscous friction of a mechanism's joint in N s/m or N m s/rad."""

    def set_friction(self, lateral: float, link: int = -1) -> None:
        """Set the lateral friction coefficient of a link."""

    def set_material(self, material: Material, link: int = -1) -> None:
        """Set how the surface of a link gives way. Raises UsageError where the engine cannot."""

    def set_inertia(self, mass: float, diagonal: Vector, link: int = -1) -> None:
        """Set the mass in kg and the principal moments in kg m2 of a link. Its centre of mass and axes stay."""


class Loads(NamedTuple):
    """The largest that each joint of an arm had since its positions were last written: (n,) each."""

    speed: Sequence[float]
    """rad/s"""
    acceleration: Sequence[float]
    """rad/s2, the mean of a control step."""
    torque: Sequence[float]
    """Of the motor, in N m."""
    wrench: float
    """The largest force of `Motors.wrench` since then, in N; with PyBullet as for `World.largest_forces`."""


class Motors(Protocol):
    """The motors of an arm and its gripper.

    Each motor of the arm follows a target speed with the torque that this takes, up to its largest torque. The gripper
    closes or opens at its speed, each finger with at most its force.
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
        """Let a spring move the tool from now on, instead of target speeds. Raises UsageError where an engine cannot.

        Dry friction then brakes the joints.
        """

    def aim(self, position: Vector, orientation: Quaternion, velocity: Vector, spin: Vector) -> None:
        """Set the set point of the spring in m, and how it moves in the next control step, in m/s and rad/s."""

    def wrench(self) -> Sequence[float]:
        """What contacts do to the tool and what moves with it: force in N and torque in N m at the tool, in its frame.

        Low-passed, and zero at a reset. A held body counts with its weight and inertia, the gripper itself does not: it
        is what a sensor at the wrist measures whose own load is compensated. With PyBullet from the first question on.
        """

    def set_wrench_filter(self, seconds: float) -> None:
        """Set the time constant in s of the wrench's low-pass, before the first step; 0: none."""

    def write(self, positions: Sequence[float], opening: float) -> None:
        """Put the joints (n,) in rad and the gripper there at rest; the motors hold the arm still."""

    def drive(self, begin: Sequence[float], end: Sequence[float], openings: Mapping[int, float]) -> None:
        """Set the target speeds of the next control step: from `begin` to `end` (n,) in rad/s, linear in time.

        After k of n physics steps a joint's target speed is begin + k / n (end - begin).
        `openings` of the gripper, in [0, 1], by the physics step of the control step, from 0 on, in which each takes
        effect; until then the gripper does as before. A cup sucks while its opening is less than half.
        """

    def read(self) -> tuple[Sequence[float], Sequence[float], float]:
        """Positions (n,) in rad and velocities (n,) in rad/s of the joints, opening of the gripper (0 without).

        Of a cup: 1 without suction, .5 while it holds something, as of fingers around a thing, else 0.
        """

    def loads(self) -> Loads:
        """The largest speed, acceleration and torque of each joint since `write`.

        Speeds and torques are those of physics steps; with PyBullet those at the ends of control steps.
        """


class World(Protocol):
    """A floor, gravity and the bodies put in. Built once: an episode begins by writing states, never by loading.

    A control step is `substeps` physics steps and takes `period` seconds.
    """

    substeps: int
    period: float
    lead: float
    """Seconds by which the velocities that the world tells are later than its positions."""

    def step(self) -> None:
        """Simulate one control step."""

    def set_gravity(self, gravity: float) -> None:
        """Set gravity along z in m/s2; negative pulls down."""

    def set_floor_friction(self, friction: float) -> None:
        """Set the lateral friction coefficient of the floor."""

    def load(self, source: Path | Mechanism, *, position: Vector = (0.0, 0.0, 0.0)) -> Body:
        """Add a mechanism, or what a URDF or MJCF file describes (`fixtures.read`); its links do not meet each other.

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
            body: the arm.
            joints: the links that its joints move, from base to wrist.
            limits: of the joints.
            fingers: of the gripper.
            tool: its frame in the last of these links; springs, the wrench and a cup need it.
            cup: instead of fingers. Not in PyBullet.
        """

    def release_in_motion(self) -> None:
        """After `motors`: let objects leave a moving hand cleanly, so that nearly the same throw lands nearly there.

        Deep contacts are corrected more slowly then.
        """

    def body(self, shapes: Sequence[Shape], mass: float, colour: Colour, inertia: Inertia | None = None) -> Body:
        """Add a body made of shapes, without air drag.

        Args:
            shapes: at least one; they may overlap.
            mass: in kg. With 0 it is static: it moves only by `place`, and meets only what moves.
            colour: of all shapes.
            inertia: that of a body as dense everywhere, if it is not given.
        """

    def marker(self, radius: float, colour: Colour) -> Body:
        """Add a translucent sphere that collides with nothing."""

    def forget_contacts(self) -> None:
        """Forget the contacts of free bodies, with their impulses, so that an episode does not depend on the last."""

    def contacts(self, first: Body, second: Body, link: int) -> Sequence[Contact]:
        """The contact points between `link` of the first body and any link of the second."""

    def forces(self, body: Body) -> dict[tuple[int, int], float]:
        """What presses on a body: the largest total normal force in N in a physics step of the last control step.

        The key is the body's link and the index of the other body. It is the body's own index where two of its links
        touch; both then have an entry. Forces that were zero throughout are left out.
        """

    def largest_forces(self, body: Body) -> dict[tuple[int, int], float]:
        """As `forces`, the largest since the joints of an arm were last written.

        With PyBullet those of the last physics step of each control step, unless `forces` has been asked for.
        """

    def render(
        self, width: int, height: int, camera: Camera, strokes: Sequence[Stroke] = (), back: float = 0.0
    ) -> Array:
        """A picture (height, width, 3) uint8.

        Args:
            strokes: what is drawn besides bodies and markers.
            back: the fraction of the way from now to the state of the last picture with 0, of which a picture is taken.
        """

    def close(self) -> None:
        """Free the world. A second call has no effect."""
