"""The numbers of an arm, and the check that they fit its URDF."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import PluginError
from ..simulation import urdf
from ..simulation.geometry import Box, Vector
from ..simulation.interface import Cup, Fingers
from ..simulation.urdf import Description, Joint, Mount

ACCELERATION_TIME = 1 / 24
"""Seconds in which a joint changes its speed by its largest speed, if no acceleration of the data sheet is used."""
FINGERS = "fingers"
"""Name in `ArmModel.self_collisions` for each finger of the mounted gripper."""


@dataclass(frozen=True)
class Flange:
    """Where a gripper is mounted on an arm."""

    link: str
    position: Vector
    """Position in the frame of the link, in m."""
    rpy: Vector
    """Orientation in that frame, rad; z points away from the arm."""


@dataclass(frozen=True)
class ArmModel:
    """The numbers of one arm; limits, efforts and speeds of the joints come from its URDF.

    The revolute and continuous joints of the URDF that are not locked are the arm: a serial chain from its base. The
    base is the link without a joint above it. Positions are those in its frame, but z is the height above the floor.
    """

    urdf: Path
    home: tuple[float, ...]
    """Joint positions in rad with the tool pointing down."""
    workspace: Box
    """Region that the tool reaches while pointing down, in m; with a flange, the tool of its own gripper."""
    tool_rpy: Vector
    """Tool frame in that of the link that the last joint moves, rad; its z axis is the direction of approach."""
    tool: Vector = (0.0, 0.0, 0.0)
    """Tool centre point in that frame, in m. With a flange it follows from the gripper."""
    flange: Flange | None = None
    """Place of the gripper; None: the URDF holds the gripper, if any, and no other can replace it."""
    cut: tuple[str, ...] = ()
    """Joints of the URDF that are left out with the hand that they carry, if a gripper is mounted."""
    gripper: str | None = None
    """Name of the gripper that is mounted by default; None: the hand in the URDF, or nothing."""
    payload: float | None = None
    """Largest load of the flange with the gripper, in kg."""
    dexterous: Box | None = None
    """Part of the workspace in which the tool can be turned by `turn` and tilted by `tilt`, in m; None: unknown."""
    floor: float = 0.0
    """Height (z) in m of the floor or table in the frame of the base."""
    tilt: float = 0.3
    """Largest angle of the tool from pointing down, in any direction, in rad."""
    turn: float = 0.8
    """Largest angle of the tool about the vertical from home, in rad."""
    turn_with: Mapping[str, float] = field(default_factory=dict)
    """`turn` with other grippers, by their names. For grippers that are not named, collisions are unknown."""
    fingers: Fingers | None = None
    """Fingers of the gripper in the URDF. With a flange they follow from the gripper."""
    cup: Cup | None = None
    """Suction cup that replaces fingers."""
    accelerations: tuple[float, ...] | None = None
    """Largest acceleration of each joint in rad/s2, from the data sheet or from the motors; None: unknown."""
    tool_speed: float | None = None
    """Largest speed of the tool centre point in m/s by the data sheet; None if it does not say."""
    tool_step: float | None = None
    """Change of the tool position per control step that slow joints allow in every direction, in m; None: the usual."""
    self_collisions: tuple[tuple[str, str], ...] = ()
    """Pairs of links that collide; all other pairs of the arm's links do not. `FINGERS` stands for each finger."""
    locked: Mapping[str, float] = field(default_factory=dict)
    """Joints that are held at a position in rad or m, such as those of a gripper with turning fingers."""
    steps_down: float = 2.0
    """A control step takes at most one part in `steps_down` of the way down to the lower end of the workspace."""
    mount: Mount | None = None
    """The gripper at the flange. `mounting.mounted` sets it."""
    gripper_mass: float = 0.0
    """Mass of the gripper at the flange in kg. `mounting.mounted` sets it."""

    @property
    def description(self) -> Description:
        """The simulated part of the URDF."""
        fingers = self.fingers.joints if self.fingers is not None else ()
        cut = self.cut if self.mount else ()
        return urdf.load(self.urdf, tuple(sorted(self.locked.items())), fingers, mount=self.mount, without=cut)


def check_model(model: ArmModel, arm: Sequence[Joint], home: Vector) -> None:
    """Refuse a model that does not fit its URDF. `home`: position of the tool at home in the base's frame, in m.

    Raises PluginError for a home outside the limits or the workspace, for fingers and links that the URDF lacks, and
    for sliding joints that nothing moves.
    """

    def demand(holds: bool, what: str, *, joint: str = "", hint: str | None = None) -> None:
        if not holds:
            raise PluginError(what, where=f"{model.urdf}{joint and f': joint {joint}'}", hint=hint)

    for joint, position in zip(arm, model.home, strict=True):
        outside = f"home is {position:g}, outside its limits from {joint.lower:g} to {joint.upper:g}"
        demand(joint.lower <= position <= joint.upper, outside, joint=joint.name)
    place, low, high = (" ".join(f"{x:.3f}" for x in at) for at in (home, model.workspace.low, model.workspace.high))
    outside = f"at home the tool is at {place}, outside the workspace from {low} to {high}"
    demand(model.workspace.contains(home), outside, hint="change `home`, `tool` or `workspace`")
    slides = {joint.name: joint for joint in model.description.joints if not joint.revolute}
    if (fingers := model.fingers) is not None:
        for name, link in zip(fingers.joints, fingers.links, strict=True):
            demand(name in slides, f"no finger joint is called {name!r}", hint=f"prismatic joints: {', '.join(slides)}")
            slide = slides.pop(name)
            what = f"finger joint {name!r} does not move a link {link!r}"
            demand(slide.child == link, what, hint=f"it moves {slide.child!r}")
            far = f"finger joint {name!r} moves by {slide.upper:g} m, `travel` is {fingers.travel:g}"
            demand(fingers.travel <= slide.upper + 1e-6, far)
    unmoved = f"nothing moves the prismatic joints {', '.join(sorted(slides))}"
    demand(not slides, unmoved, hint="name them in `fingers` or `locked`")
    for link in {link for pair in model.self_collisions for link in pair}:
        known_link = link in model.description.carriers
        demand(known_link, f"self_collisions names a link {link!r}, which the URDF lacks")


def arm_joints(model: ArmModel) -> list[Joint]:
    """The joints of the arm. Raises PluginError if they are not a serial chain, or do not fit the home pose."""
    found = [joint for joint in model.description.joints if joint.revolute]
    for before, joint in zip([None, *found], found, strict=False):
        problem = None
        if joint.mimic is not None:
            problem = f"it mimics {joint.mimic}, and karolos drives every joint of an arm by itself"
        elif before is not None and joint.parent != before.child:
            problem = f"it does not follow joint {before.name}: an arm is a serial chain"
        if problem is not None:
            raise PluginError(problem, where=f"{model.urdf}: joint {joint.name}", hint="name it in `locked`")
    if len(found) != len(model.home):
        raise PluginError(
            f"{len(found)} revolute joints, but a home pose for {len(model.home)} joints",
            where=str(model.urdf),
            hint=f"the joints that are not locked: {', '.join(joint.name for joint in found)}",
        )
    return found
