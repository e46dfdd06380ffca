"""Proposes the model of an arm from a URDF. Missing facts are computed, and noted as assumptions."""

from __future__ import annotations

import re
import textwrap
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import product
from math import pi
from pathlib import Path
from pprint import pformat
from xml.etree.ElementTree import Element
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from ..core import Array
from ..errors import PluginError, UsageError
from ..registry import load
from ..simulation import urdf
from ..simulation.fixtures import hulls
from ..simulation.geometry import Box, Vector
from ..simulation.interface import Fingers, Gripper
from ..simulation.meshes import LARGEST_NUMBER, MESH_SUFFIXES, triangles
from ..simulation.urdf import Joint
from ..system.files import find_named
from .grippers.parallel import GripperModel
from .loads import MotorLoads
from .model import FINGERS, ArmModel, Flange
from .mounting import mounted
from .poses import BETTER, ENOUGH, LEAST, MORE, SMALLEST_WORKSPACE, Outline, Place, Poses, spanning
from .settings import ArmSettings

GRIPPER_NAMES = re.compile(r"grip|finger|jaw|claw|knuckle|thumb", re.IGNORECASE)
"""Names of joints that do not belong to the arm."""
HAND_NAMES = re.compile(rf"{GRIPPER_NAMES.pattern}|hand|palm|robotiq", re.IGNORECASE)
"""Names of links beyond the last joint that belong to a hand."""
FLANGE_NAMES = tuple(
    re.compile(pattern, re.IGNORECASE) for pattern in (r"flange|tool0|attach", r"tool|(^|_)ee(_|$)|end_?eff")
)
"""Names of frames that may be the flange, the best first."""
TOOL_NAMES = tuple(
    re.compile(pattern, re.IGNORECASE)
    for pattern in (r"grasp|tcp|tool_?cent|tool_?point", r"tool|(^|_)ee(_|f|$)|end_?eff", r"flange")
)
"""Names of frames that may be the tool, the best first."""
PARALLEL = 0.99
"""Cosine of the largest angle between two directions that count as the same."""
LEAST_JOINTS = 5
"""Least number of turning joints of an arm: with fewer it cannot point its tool down at any place."""
DOUBTED_SPEED, DOUBTED_ANGLE, DOUBTED_TRAVEL = 2 * pi, 4 * pi, 2.0
"""Largest plausible limits of joints: speed in rad/s, angle in rad, speed in m/s or range in m of a slide."""
DOUBTED_RANGE = 0.2
"""Smallest plausible range of a turning joint in rad."""
SLOW = 0.4
"""Smallest plausible speed in rad/s."""
DOUBTED_MASS, DOUBTED_RADII, DOUBTED_LENGTH = 500.0, (0.001, 1.0), 3.0
"""Largest mass of a link in kg, smallest and largest radius of gyration in m, largest length of an arm in m."""
DOUBTED_DENSITY = 3.0, 200.0
"""Smallest and largest mass of an arm per square of its length, in kg/m2: a VX300s has 4, a UR5 16, a KR210 107."""
DOUBTED_WEIGHT = 0.7
"""Fraction of a motor's torque for the arm's own weight that causes a doubt if larger."""
WEAK = 1.2
"""The same with which an arm cannot be used, because it does not hold itself. Of 32 arms one has more than 1.0: 2.6."""
SHOULDERS = (0.3, 0.6)
"""Heights of the second joint above a table, per length of the arm: standing, and hanging."""
PAD_DEPTH = 0.01
"""Distance in m from the tips of the fingers to the tool centre point."""
OFF_VERTICAL = 0.2
"""Largest angle in rad between the tool at a known home and the direction down."""
USUAL_STEP: float = ArmSettings.model_fields["tool_step"].default
"""Length in m."""
HIDDEN_DEPTH = 0.01
"""Length in m by which shapes may extend beyond a tool frame or flange that the file names."""
FLOOR_CLEARANCE, LOWEST = 0.005, 0.02
"""Height in m of the tips of a gripper above the floor, at its lowest, and of a tool without a gripper."""


@dataclass(frozen=True)
class Known:
    """Facts from a person, which replace those of the URDF and of this module."""

    tool: str | None = None
    """Link of the tool frame, with z forwards."""
    flange: str | None = None
    """Link on which a gripper is mounted, with z away from the arm."""
    flange_yaw: float | None = None
    """Turn of a gripper about the flange's z, in rad."""
    home: tuple[float, ...] | None = None
    """Joint positions in rad in which the tool points down."""
    workspace: Box | None = None
    payload: float | None = None
    """Payload in kg."""
    tool_speed: float | None = None
    """Largest speed of the tool in m/s."""


NOTHING = Known()


@dataclass(frozen=True)
class Proposal:
    """A model for a URDF, with its assumptions in words."""

    model: ArmModel
    summary: str
    notes: tuple[str, ...]
    """Assumptions, one line each."""
    overload: str = ""
    """Why the motors cannot hold the arm; empty if they can. Such an arm has a proposal, but no spec can use it."""

    def code(self) -> dict[str, str]:
        """Values for the templates of a starter package. Texts from the URDF are Python literals."""
        model = self.model
        given = [one for one in fields(model) if one.name != "urdf" and getattr(model, one.name)]
        lines = "\n".join(f"{one.name}={pformat(getattr(model, one.name), width=100)}," for one in given)
        edges = np.subtract(model.workspace.high, model.workspace.low)
        return {
            "summary": self.summary,
            "assumed": pformat(self.notes, width=112)[1:-1].replace("\n ", "\n    "),
            "imports": ", ".join(name for name in ("Box", "Fingers", "Gripper") if f"{name}(" in lines),
            "model_imports": ", ".join(["ArmModel", *["Flange"] * ("Flange(" in lines)]),
            "tool_step": repr(model.tool_step or USUAL_STEP),
            "model": textwrap.indent(lines, " " * 8),
            "threshold": "0.05" if edges.min() > 0.2 else "0.02",
        }


def propose(path: Path, gripper: str | None = None, known: Known = NOTHING) -> Proposal:
    """A model of the arm in this URDF.

    Args:
        path: of the file.
        gripper: replaces the file's own hand at the arm's flange; None: the hand in the file, if any.
        known: facts that need not be assumed.

    Raises:
        PluginError: the file is not a robot that karolos can simulate, or not an arm that can point its tool down. The
            message names the joint or link.
        UsageError: the gripper is unknown, or too heavy, or a known home or workspace does not fit the arm.
    """
    found, locked, still, beyond = _read(path, known, cut=gripper is not None)
    joints = [joint for joint in found.joints if joint.revolute]
    base, last = joints[0].parent, joints[-1]
    hand = _hand(found, [joint for joint in found.joints if not joint.revolute])
    model = ArmModel(
        urdf=path,
        home=(),
        workspace=known.workspace or Box((0.0,) * 3, (0.0,) * 3),
        tool_rpy=(0.0,) * 3,
        gripper=gripper,
        cut=tuple(beyond),
        payload=known.payload,
        tool_speed=known.tool_speed,
        locked=locked,
    )
    places = _flanges(found, last, beyond, hand, known)
    if gripper is None:
        position, rotation, tool_note = _tool(found, path, last, hand, known.tool)
        model = replace(model, tool=_vector(position), tool_rpy=_rpy(rotation), fingers=hand.fingers)
        tries = [replace(model, flange=places[0][0])]
        hand_note = hand.note
    else:
        tries = [replace(model, flange=flange, tool_rpy=flange.rpy) for flange, _ in places]
        tool_note, hand_note = places[0][1], f"gripper: {gripper} at the flange"
        hand_note += f", in place of what {', '.join(beyond)} carry" if beyond else ""
    site, *others = (_Site(one, hand, found.robot, known) for one in tries)
    first = site
    for other in others if site.worth < ENOUGH else ():
        site = other if other.worth > BETTER * site.worth else site
    place, whole, poses = site.place, site.whole, site.poses
    if place is None:
        raise _unplaced(path, joints)
    low, high, dexterous = place.workspace.low, place.workspace.high, place.dexterous
    where = "none found: tasks whose goal is a pose refuse this robot"
    if dexterous is not None:
        where = (
            f"{_metres(dexterous.low)} to {_metres(dexterous.high)} m; the tool can be turned by {ArmModel.turn:g} rad "
            f"and tilted by {ArmModel.tilt:g} there"
        )
    filled = ", ".join(f"{name} ({what} filled)" for name, what in hulls(found.robot).items())
    loads = MotorLoads(whole.description)
    accelerations = loads.accelerations(place.corners)
    slower = ", ".join(f"{one:g}" for one in accelerations or ())
    shares = loads.shares(place.corners)
    weights = [f"{one.name} {share:.0%}" for one, share in zip(joints, shares, strict=True) if share > DOUBTED_WEIGHT]
    heavy = ", ".join(found.corrected)
    names = [*(joint.child for joint in joints), base]
    pairs = tuple((names[a], end) for a, b in site.pairs for end in [names[b], *[FINGERS] * (b == len(joints) - 1)])
    pairs = tuple(pair for pair in pairs if FINGERS not in pair or whole.fingers is not None)
    slow = place.tool_step < USUAL_STEP
    standing = "on the floor z = 0"
    if site.floor:
        standing = f"{abs(site.floor):g} m {'below' if site.floor > 0 else 'above'} the table that it works on"
    merged = ", ".join(name for name, carrier in found.carriers.items() if carrier == base and name != base)
    notes = {
        f"base: {base}{merged and f' (with {merged})'}, at the origin of the world, {standing}": True,
        f"arm: {', '.join(joint.name for joint in joints)}": True,
        hand_note: True,
        f"locked, they do not move: {', '.join(still)}": still,
        f"inertia of {heavy}: no body can have it; its smaller moments are raised": heavy,
        **{f"doubted: {doubt}": True for doubt in doubts(found)},
        f"doubted: gravity takes {', '.join(weights)} of the torque; compare the data sheet": weights,
        tool_note: True,
        "flange: the gripper is turned by pi/2, so that its fingers close across": site is not first,
        f"home: tool at {_metres(place.tool)} m, pointing down; by inverse kinematics, far from joint limits": True,
        f"workspace: {_metres(low)} to {_metres(high)} m; actions lead the tool through it, pointing down": True,
        f"dexterous: {where}": True,
        f"tool_step: {place.tool_step} m per control step instead of {USUAL_STEP}: the joints are slower": slow,
        f"accelerations: {slower} rad/s2, which the torques can give to all joints at once": slower,
        f"collision: the convex hulls of {filled}": filled,
        f"self-collisions: {len(pairs)} pairs of links, which are apart in the whole workspace": True,
    }
    model = replace(
        site.model,
        accelerations=accelerations,
        home=place.home,
        workspace=place.workspace,
        dexterous=dexterous,
        floor=site.floor,
        tool_step=place.tool_step if slow else None,
        self_collisions=pairs,
    )
    width = whole.fingers and whole.fingers.gripper.width
    held = f"a gripper of two fingers that opens {100 * width:g} cm" if width else "without a gripper"
    summary = f"{len(joints)} joints, {poses.length:.2f} m long, {held}."
    overload = f"gravity takes {', '.join(weights)} of the torque: the arm cannot hold itself and its hand"
    noted = tuple(note for note, holds in notes.items() if holds)
    return Proposal(model, summary, noted, overload if max(shares) > WEAK else "")


def _unplaced(path: Path, joints: Sequence[Joint]) -> PluginError:
    """The error of an arm without a home and a workspace."""
    what = f"no box of {100 * SMALLEST_WORKSPACE:g} cm was found that the tool reaches pointing down"
    hint = "choose the tool with --tool LINK; the z axis of the base points upwards"
    if narrow := [joint.name for joint in joints if joint.upper - joint.lower < DOUBTED_RANGE]:
        unit = "a URDF has rad, and MJCF degrees unless it says otherwise"
        hint = f"{', '.join(narrow)} turn by less than {DOUBTED_RANGE:g} rad; {unit}"
    return PluginError(what, where=str(path), hint=hint)


def _read(
    path: Path, known: Known, *, cut: bool
) -> tuple[urdf.Description, dict[str, float], list[str], dict[str, tuple[Array, Array]]]:
    """The simulated part of a file, the joints held at a position, all fixed joints, and `_hand_joints`.

    Args:
        path: of the file.
        known: names that need no search.
        cut: whether to leave out the file's own hand.
    """
    loose = urdf.load(path, strict=False)
    for name in (known.tool, known.flange):
        if name is not None and name not in loose.carriers:
            raise UsageError(f"there is no link {name!r}", where=str(path), hint=f"links: {', '.join(loose.carriers)}")
    arm = _arm(loose, path, known.tool)
    beyond = _hand_joints(path, arm[-1].child)
    without = tuple(beyond) if cut else ()
    left = urdf.load(path, strict=False, without=without)
    slides = tuple(one.name for one in left.joints if not one.revolute and one.parent == arm[-1].child)
    slides = slides if len(slides) == 2 else ()
    moving = {joint.name for joint in arm} | {*slides}
    still = [joint for joint in left.joints if joint.name not in moving]
    locked = {  # at 0, or at the end of the range that is nearest to 0
        joint.name: min(max(0.0, joint.lower), joint.upper) if joint.lower < joint.upper else 0.0
        for joint in still
        if joint.mimic is None or joint.mimic in moving
    }
    found = urdf.load(path, tuple(sorted(locked.items())), slides, without=without)
    _check_known(known, [joint for joint in found.joints if joint.revolute])
    return found, locked, [*found.stopped, *(joint.name for joint in still)], beyond


class _Site:
    """Home and workspace of an arm with its hand or gripper.

    Args:
        model: complete except for home, workspace and what follows from them.
        hand: the file's own hand.
        robot: the simulated part of the file.
        known: facts that need no search.
    """

    def __init__(self, model: ArmModel, hand: _Hand, robot: Element, known: Known) -> None:
        self.model, self.whole, self._known = model, mounted(model, None), known
        description = self.whole.description
        joints = [joint for joint in description.joints if joint.revolute]
        turn = urdf.rotation_matrix(*self.whole.tool_rpy)
        tool = np.array(self.whole.tool), turn
        pads, lowest, across = hand.tips, LOWEST, hand.across
        if model.gripper is not None:
            gripper: GripperModel = load("grippers", model.gripper).model
            lowest, slides = gripper.least_height, [one for one in description.joints if not one.revolute]
            across = np.array(slides[0].rotation) @ slides[0].axis if slides else np.zeros(3)
            pads = np.vstack([np.zeros((0, 3)), *(_points_moved(description.robot, one) for one in slides)])
        elif len(pads):
            lowest = FLOOR_CLEARANCE + max(float(((pads - tool[0]) @ turn[:, 2]).max()), 2 * FLOOR_CLEARANCE)
        x, y, _ = (turn.T @ across).tolist()
        shapes = tuple(spanning(points_of(description.robot, joint.child)) for joint in joints)
        base = spanning(points_of(robot, joints[0].parent))
        body = Outline(shapes, spanning(pads), base, lowest, (x, y) if across.any() else None)
        self._made = joints, tool, body, USUAL_STEP
        self.poses, self.floor = Poses(*self._made), 0.0

    @cached_property
    def place(self) -> Place | None:
        """Home and workspace above the floor; None if the tool cannot point down.

        If an arm has hardly any room in front of its base, the table is assumed to be lower or higher than the base.
        """
        home, workspace = self._known.home, self._known.workspace
        if home is not None:
            if (off := self.poses.off_vertical(home)) > OFF_VERTICAL:
                what = f"the tool points {off:.2f} rad away from down"
                raise UsageError(what, setting="robot.home", hint="at home z of the tool frame points down")
            return self.poses.at(home, workspace)
        found, first = self.poses.best(), self.poses
        x, y = np.subtract(found.tool[:2], first.middle) if found is not None else (0.0, 0.0)
        ahead = found is not None and found.room > LEAST and x > abs(y)
        for share in () if ahead else SHOULDERS:
            floor = round(first.shoulder - share * first.length, 2)
            poses = Poses(*self._made, floor)
            other = poses.best()
            if other is not None and other.worth > (MORE * found.worth if found is not None else 0.0):
                found, self.poses, self.floor = other, poses, floor
        return found if found is None or workspace is None else self.poses.at(found.home, workspace)

    @property
    def worth(self) -> float:
        """`Place.worth`; 0 without a place."""
        return self.place.worth if self.place is not None else 0.0

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Pairs of links that can collide, see `Poses.pairs`."""
        return self.poses.pairs(self.place.corners) if self.place is not None else []


def doubts(found: urdf.Description) -> list[str]:
    """Doubts about the numbers of a URDF, one line each: wrong units and placeholders."""
    said: dict[str, list[str]] = defaultdict(list)
    for joint in found.joints:
        unit, most, fast, meant = "m", DOUBTED_TRAVEL, DOUBTED_TRAVEL, "millimetres"
        if joint.revolute:
            unit, most, fast, meant = "rad", DOUBTED_ANGLE, DOUBTED_SPEED, "degrees"
        if most < (far := max(-joint.lower, joint.upper)) < LARGEST_NUMBER:
            said[f"to {far:g} {unit}; are these {meant}?"].append(f"joint {joint.name}")
        if joint.revolute and joint.velocity < SLOW:
            said[f"at {joint.velocity:g} rad/s only; compare the data sheet"].append(f"joint {joint.name}")
        if joint.velocity > fast:
            said[f"at {joint.velocity:g} {unit}/s; compare the data sheet"].append(f"joint {joint.name}")
    moved = {joint.child for joint in found.joints}
    for link in found.robot.findall("link"):
        mass, _, tensor = urdf.inertia_of(link)
        if (name := link.get("name", "")) not in moved or not mass:
            continue
        if mass > DOUBTED_MASS:
            said[f"{mass:g} kg; are these grams?"].append(f"link {name}")
        least, _, most = np.linalg.eigvalsh(tensor).tolist()
        if not DOUBTED_RADII[0] ** 2 <= least / mass <= most / mass <= DOUBTED_RADII[1] ** 2:
            said[f"moments from {least:.3g} to {most:.3g} kg m2 at {mass:g} kg; compare the CAD"].append(f"link {name}")
    if found.robot.find("link/collision") is None:
        said["without shapes, so it collides with nothing"].append("the arm")
    length = _length([joint for joint in found.joints if joint.revolute], found)
    if length > DOUBTED_LENGTH:
        said["in other units than metres?"].append(f"a length of {length:.3g} m")
    mass = sum(urdf.inertia_of(link)[0] for link in found.robot.findall("link") if link.get("name") in moved)
    least, most = (density * length**2 for density in DOUBTED_DENSITY)
    if mass and not least <= mass <= most:
        what = f"from {least:.3g} to {most:.3g} kg is usual for {length:.3g} m; compare the data sheet"
        said[what].append(f"{mass:.4g} kg in all links that move")
    return [f"{', '.join(of)}: {what}" for what, of in said.items()]


def _length(arm: Sequence[Joint], found: urdf.Description) -> float:
    """Length in m of an arm from its base, which may stand somewhere in a link of the world."""
    lengths = [float(np.linalg.norm(joint.origin)) for joint in arm]
    bases = [one.parent for one in arm[:1]]
    places = [place for frame, (place, _) in found.frames.items() if found.carriers[frame] in bases]
    lengths[:1] = [min(float(np.linalg.norm(one.origin - place)) for place in places) for one in arm[:1]]
    return sum(lengths)


def propose_gripper(path: Path, tool: str | None = None) -> tuple[dict[str, str], tuple[str, ...]]:
    """Values for the template of a gripper from this URDF, and the assumptions.

    Args:
        path: of the file. Its base is mounted on the flange, z away from the arm.
        tool: the link of the tool centre point; by default it lies before the tips of the fingers.

    Raises:
        PluginError: the file is not a gripper of two sliding fingers.
    """
    loose = urdf.load(path, strict=False)
    slides = tuple(joint.name for joint in loose.joints if not joint.revolute)
    if len(slides) != 2 or len(loose.joints) != 2:
        what = f"{len(loose.joints)} joints that move, {len(slides)} of which slide"
        hint = "two sliding fingers; make the others fixed, and stand-ins of a linkage sliding, in a copy of the URDF"
        raise PluginError(what, where=str(path), hint=hint)
    found = urdf.load(path, slides=slides)
    hand, base = _hand(found, found.joints), found.joints[0].parent
    if abs(hand.across[2]) > 0.1:
        raise PluginError("the fingers slide along z", where=str(path), hint="z of the base points away from the arm")
    middle, tip = (hand.tips.min(0) + hand.tips.max(0)) / 2, float(hand.tips[:, 2].max())
    if middle[2] < float(np.linalg.norm(middle[:2])) or tip <= 0:
        what = f"the middle of the fingers is at {_metres(middle)} m in {base}: they are not ahead of it along z"
        hint = "put a link with z away from the arm before it, by a fixed joint"
        raise PluginError(what, where=str(path), hint=hint)
    place, what = np.array([*middle[:2], tip - PAD_DEPTH]), f"{PAD_DEPTH:g} m from the tips of the fingers"
    if tool is not None:
        if found.carriers.get(tool) != base:
            raise PluginError(f"no link {tool!r} is fixed to {base}", where=str(path))
        place, what = found.frames[tool][0], f"the frame {tool}"
    height = round(max(tip - float(place[2]), 0.0) + FLOOR_CLEARANCE, 4)
    notes = (
        f"base: {base} is mounted on the flange, its z axis away from the arm",
        hand.note,
        f"tool: {what}, {_metres(place)} m in {base}",
        f"least height: {height:g} m of the tool above the floor; there the tips are {FLOOR_CLEARANCE:g} m above it",
    )
    fingers = textwrap.indent(pformat(hand.fingers, width=100), " " * 16).lstrip()
    return {"tool": repr(_vector(place)), "fingers": fingers, "height": repr(height)}, notes


def _check_known(known: Known, joints: Sequence[Joint]) -> None:
    """Refuse a home for other joints, and a workspace without volume. Raises UsageError."""
    if known.home is not None and len(known.home) != len(joints):
        what = f"{len(known.home)} positions for the joints {', '.join(joint.name for joint in joints)}"
        raise UsageError(what, setting="robot.home", hint=f"{len(joints)} positions in rad")
    if known.workspace is not None and not np.less(known.workspace.low, known.workspace.high).all():
        what = f"no box from {_metres(known.workspace.low)} to {_metres(known.workspace.high)} m"
        raise UsageError(what, setting="robot.workspace", hint="the lower corner first: [[x, y, z], [x, y, z]]")


def _metres(place: Sequence[float] | Array) -> str:
    return " ".join(f"{round(float(value), 3) + 0.0:.3f}" for value in place)


def _rpy(rotation: Array) -> Vector:
    return _vector(urdf.roll_pitch_yaw(rotation))


def _vector(values: Sequence[float] | Array) -> Vector:
    x, y, z = (round(float(value), 6) + 0.0 for value in values)
    return x, y, z


def _arm(found: urdf.Description, path: Path, tool: str | None) -> list[Joint]:
    """The turning joints from the base to the wrist: those before the tool, or those of the longest chain."""
    joints, above = {joint.name: joint for joint in found.joints}, {joint.child: joint for joint in found.joints}
    leaders = {joint.mimic for joint in found.joints}

    def chain(link: str) -> tuple[str, ...]:
        names: list[str] = []
        while link in above:
            joint, link = above[link], above[link].parent
            finger = joint.mimic is not None or joint.name in leaders or GRIPPER_NAMES.search(joint.name)
            if finger and (tool is None or not names):
                names = []
            elif joint.revolute:
                names.insert(0, joint.name)
        return tuple(names)

    if tool is not None:
        arm = chain(found.carriers[tool])
    else:
        chains = {chain(link) for link in found.carriers.values()}
        longest = sorted(one for one in chains if len(one) == max(map(len, chains)))
        arm = tuple(one for one, *others in zip(*longest, strict=True) if all(one == other for other in others))
        # Shorter branches are fingers, and so are all behind an arm.
        if len(longest) > 1 and len(longest[0]) - len(arm) > 2 and len(arm) < LEAST_JOINTS:
            first, last = ([joints[one[place]] for one in longest] for place in (len(arm), -1))
            raise PluginError(
                f"{len(longest)} arms begin here, with joints {', '.join(joint.name for joint in first)}",
                where=f"{path}: link {first[0].parent}",
                hint=f"choose one by a link at its end: {' or '.join(f'--tool {joint.child}' for joint in last)}",
            )
    for name in arm:
        if joints[name].mimic is not None:
            what = f"it mimics {joints[name].mimic}; karolos drives every joint of an arm by itself"
            raise PluginError(what, where=f"{path}: joint {name}")
    if len(arm) < LEAST_JOINTS:
        raise PluginError(
            f"the arm has only {len(arm)} turning joint{'s' * (len(arm) != 1)} ({', '.join(arm) or 'none'})",
            where=str(path),
            hint="with five or more it can point its tool down at any place; --tool LINK chooses its end",
        )
    return [joints[name] for name in arm]


def _hand_joints(path: Path, link: str) -> dict[str, tuple[Array, Array]]:
    """The joints that carry a hand on an arm's last link (moving ones, or with typical names), with their frames in it.

    The rotation (3, 3) of a moving joint is 0, because it does not say where the hand points.
    """
    below, found = urdf.read(path).findall("joint"), dict[str, tuple[Array, Array]]()
    reached = [(link, np.zeros(3), np.eye(3))]
    for name, place, turn in reached:  # which grows
        for joint in below:
            if urdf.link_of(joint, "parent") != name:
                continue
            offset, rotation = urdf.origin_of(joint)
            child, there = urdf.link_of(joint, "child"), place + turn @ offset
            moves = joint.get("type") != "fixed"
            if moves or HAND_NAMES.search(child):
                found[joint.get("name", "")] = there, np.zeros((3, 3)) if moves else turn @ rotation
            else:
                reached.append((child, there, turn @ rotation))
    return found


def _flanges(
    found: urdf.Description, last: Joint, beyond: dict[str, tuple[Array, Array]], hand: _Hand, known: Known
) -> list[tuple[Flange, str]]:
    """Places for a gripper, with notes: as it is, and turned by pi/2 unless the turn is known.

    The place is the frame that the user named, a frame with a usual name, the beginning of the file's own hand, or the
    end of the last link along its joint's axis. If shapes extend beyond it, the place is at their end.
    """
    usual = [one for one in _frames_like(found, last, FLANGE_NAMES) if not HAND_NAMES.search(one)]
    name = known.flange or next(iter(usual), None)
    axis, (place, turn) = np.array(last.axis), _frame_of(found, last, name)
    shapes, what = points_of(found.robot, last.child), f"the frame {name}"
    before = np.transpose(last.rotation) @ last.origin  # from the joint before to this one
    ends = (shapes.min(0, initial=0.0) + shapes.max(0, initial=0.0)) / 2
    parallel = [frame[:, 2] for _, frame in beyond.values() if abs(frame[:, 2] @ axis) > PARALLEL]
    hints = (*parallel, *(origin for origin, _ in beyond.values()), place, before, ends)
    ahead = [*(origin for origin, _ in beyond.values()), place]
    approach = _approach(turn if name is not None else None, axis, hints, ahead, sure=known.flange is not None)
    if name is None and beyond:
        nearest = min((origin for origin, _ in beyond.values()), key=lambda one: float(one @ approach))
        place = nearest if len(beyond) == 1 else approach * float(nearest @ approach)
        what = f"where {', '.join(beyond)} carry the file's own hand"
    end = float((shapes @ approach).max(initial=0.0))
    if known.flange is None and (end > float(place @ approach) + HIDDEN_DEPTH or (name is None and not beyond)):
        place, what = place + (end - float(place @ approach)) * approach, "the end of its shapes"
    frame, where = _frame(turn, approach, hand.across), _vector(place)
    note = f"flange: {what}, {_metres(place)} m in {last.child}, away from the arm along {_metres(approach)}"
    yaws = (0.0, pi / 2) if known.flange_yaw is None else (known.flange_yaw,)
    made = (_rpy(frame @ urdf.about((0.0, 0.0, 1.0), yaw)) for yaw in yaws)
    return [(Flange(last.child, where, rpy), note) for rpy in made]


def _frames_like(found: urdf.Description, last: Joint, names: Sequence[re.Pattern[str]]) -> list[str]:
    """The frames on the last link of such names, the best first."""
    frames = [name for name, one in found.carriers.items() if one == last.child != name]
    return list(dict.fromkeys(one for like in names for one in frames if like.search(one)))


def _frame_of(found: urdf.Description, last: Joint, name: str | None) -> tuple[Array, Array]:
    """Position (3,) and rotation (3, 3) of a frame on the last link; None: of the link itself."""
    if name is not None and found.carriers.get(name) != last.child:
        raise PluginError(f"fixed joints do not hold it to {last.child}", where=f"link {name}")
    return found.frames[name] if name is not None else (np.zeros(3), np.eye(3))


def _approach(turn: Array | None, axis: Array, hints: Iterable[Array], ahead: Sequence[Array], *, sure: bool) -> Array:
    """The direction (3,) in which a tool extends from the last link.

    Args:
        turn: rotation (3, 3) of a named frame; None: no frame is named.
        axis: of the last joint. The tool extends along it, unless the frame is sure.
        hints: points and directions (3,) ahead of the tool, the best first.
        ahead: points (3,) of the file's own hand and the frame. If all are behind the joint, the frame's z is, too.
        sure: whether a person named the frame.
    """
    if turn is not None and (sure or abs(turn[:, 2] @ axis) >= PARALLEL):
        found: Array = turn[:, 2]
        behind = len(ahead) > 1 and all(float(point @ found) < -0.005 for point in ahead)
        return -found if behind and not sure else found
    along = [depth for hint in hints if abs(depth := float(hint @ axis)) > 0.005]
    return -axis if along and along[0] < 0 else axis


def _frame(turn: Array, approach: Array, across: Array) -> Array:
    """A rotation (3, 3) with z along the approach, and y along the fingers' way or x as in another rotation."""
    x = min(turn.T, key=lambda column: abs(float(column @ approach)))
    x = np.cross(across, approach) if across.any() else x - (x @ approach) * approach
    x = x / np.linalg.norm(x)
    return np.column_stack([x, np.cross(approach, x), approach])


@dataclass(frozen=True)
class _Hand:
    """The gripper on the last link. Points and directions are in the frame of that link."""

    note: str
    fingers: Fingers | None = None
    tips: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """Points (n, 3) of the fingers."""
    across: Array = field(default_factory=lambda: np.zeros(3))
    """Direction in which the first finger slides."""


def _hand(found: urdf.Description, pair: Sequence[Joint]) -> _Hand:
    """The gripper of two sliding fingers, if there is a pair of them."""
    if not pair:
        return _Hand("gripper: no pair of sliding fingers, so that tasks which grasp do not work")
    names = ", ".join(joint.name for joint in pair)
    across, other = (np.array(joint.rotation) @ joint.axis for joint in pair)
    if across @ other > -PARALLEL:
        raise PluginError(
            "the fingers do not slide in opposite directions",
            where=f"joints {names}",
            hint="mount another gripper in their place (robotiq_2f85), or make them fixed in a copy of the URDF",
        )
    pads = [_points_moved(found.robot, one) for one in pair]
    pads = [pad if len(pad) else np.array([joint.origin]) for pad, joint in zip(pads, pair, strict=True)]
    travel, force, speed = (min(getattr(one, limit) for one in pair) for limit in ("upper", "effort", "velocity"))
    closes = bool((pads[0].min(0) + pads[0].max(0) - pads[1].min(0) - pads[1].max(0)) @ across < 0)
    inwards = -across if closes else across
    gap = float((pads[0] @ inwards).min() - (pads[1] @ inwards).max()) - closes * 2 * travel
    width = round(2 * travel + (gap if gap > 0.005 else 0.0), 4)
    note = (
        f"gripper: {names}, {'closing' if closes else 'opening'} from 0 to {travel:g} m, "
        f"{width:g} m wide when open; {force:g} N and {speed:g} m/s are the limits in the URDF; "
        "pad friction 1 as of rubber"
    )
    gripper = Gripper(width=width, force=force, speed=speed, pad_friction=1.0)
    links = pair[0].child, pair[1].child
    fingers = Fingers((pair[0].name, pair[1].name), links, travel, closes, gripper)
    return _Hand(note, fingers, np.vstack(pads), across)


def _tool(found: urdf.Description, path: Path, last: Joint, hand: _Hand, named: str | None) -> tuple[Array, Array, str]:
    """Position and rotation of the tool in the frame of the last link, z along the direction of approach, and a note.

    It is the frame that the user named, or a frame with a usual name between the fingers. Otherwise it is at the tips
    of the fingers, or at the end of the last link along its joint's axis.
    """
    usual = _frames_like(found, last, TOOL_NAMES)
    name = named or next(iter(usual), None)
    place, turn = _frame_of(found, last, name)
    tips, axis, shapes = hand.tips, np.array(last.axis), points_of(found.robot, last.child)
    before = np.transpose(last.rotation) @ last.origin  # from the joint before to this one
    middle, ends = ((points.min(0, initial=0.0) + points.max(0, initial=0.0)) / 2 for points in (tips, shapes))
    approach = _approach(
        turn if name is not None else None, axis, (middle, place, before, ends), [*tips, place], sure=named is not None
    )
    what = f"the frame {name}"
    if abs(approach @ hand.across) > 0.1:
        raise PluginError(
            "the fingers slide along the direction of approach",
            where=f"{path}: link {last.child}",
            hint="name the tool frame, whose z axis is this direction, with --tool LINK",
        )
    depths = tips @ approach
    if len(tips) and named is None and not (name and depths.min() < place @ approach < depths.max()):
        what, middle = f"{PAD_DEPTH:g} m from the tips of the fingers", (tips.min(0) + tips.max(0)) / 2
        place = middle + (depths.max() - PAD_DEPTH - middle @ approach) * approach
    elif not len(tips) and named is None:
        end, depth = max(0.0, float((shapes @ approach).max(initial=0.0))), float(place @ approach)
        if name is None or end > depth + HIDDEN_DEPTH:
            place, what = place + (end - depth) * approach, "the end of its shapes"
    note = f"tool: {what}, {_metres(place)} m in {last.child}; it approaches along {_metres(approach)}"
    if others := [one for one in usual if named is None and what != f"the frame {one}"]:
        note += f"; not {', '.join(others)}, which --tool LINK chooses"
    return place, _frame(turn, approach, hand.across), note


def points_of(robot: Element, link: str) -> Array:
    """Points (n, 3) that span the collision shapes of a link, or its visual ones, in its frame in m."""
    element = next(one for one in robot.findall("link") if one.get("name") == link)
    found = [np.zeros((0, 3))]
    for shape in element.findall("collision") or element.findall("visual"):
        translation, rotation = urdf.origin_of(shape)
        found += [_corners(one) @ rotation.T + translation for one in shape.findall("geometry/*")]
    return np.vstack(found)


def _points_moved(robot: Element, joint: Joint) -> Array:
    """The same for the link after a joint at 0, in the frame of the link before it."""
    moved: Array = points_of(robot, joint.child) @ np.transpose(joint.rotation) + joint.origin
    return moved


def _corners(shape: Element) -> Array:
    """Points (n, 3) of a shape in its own frame."""
    size = {key: [float(one) for one in value.split()] for key, value in shape.attrib.items() if key != "filename"}
    if shape.tag == "mesh":
        scale = np.array(size.get("scale", [1.0, 1.0, 1.0]))
        return scale * triangles(Path(shape.get("filename", ""))).reshape(-1, 3)
    if shape.tag == "box":
        half = np.array(size["size"]) / 2
    else:
        radius, length = size["radius"][0], size.get("length", [0.0])[0]
        half = np.array([radius, radius, length / 2 if shape.tag == "cylinder" else length / 2 + radius])
    corners: Array = half * np.array(list(product((-1, 1), repeat=3)))
    return corners


def with_meshes(path: Path) -> tuple[str, dict[str, Path]]:
    """A URDF with its meshes in the folder `meshes` next to it, and the files to copy there, by their new names."""
    text, files, robot = urdf.text_of(path), dict[str, Path](), urdf.read(path)
    solid = [link for link in robot.iter("link") if link.find("collision") is not None]
    for shape in [one for link in solid for one in link.findall("visual")]:
        if any(mesh.get("filename", "").lower().endswith(".dae") for mesh in shape.iter("mesh")):
            shape.clear()  # then the link is drawn by its collision shapes
    for number, name in enumerate(sorted({mesh.get("filename", "") for mesh in robot.iter("mesh")})):
        mesh = find_named(name, path.parent)
        if mesh is not None and mesh.suffix.lower() in MESH_SUFFIXES:
            new = next((to for to, file in files.items() if file == mesh), f"meshes/{number}_{mesh.name}")
            files[new] = mesh
            text = quoteattr(new).join(re.split(rf"""(["']){re.escape(escape(name))}\1""", text)[::2])
    return text, files
