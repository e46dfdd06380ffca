"""A robot plugin proposed from somebody's URDF: what the file does not say is computed, and noted as an assumption."""

from __future__ import annotations

import re
import textwrap
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from itertools import product
from math import pi
from pathlib import Path
from pprint import pformat
from xml.etree.ElementTree import Element
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from ..core import Array
from ..errors import PluginError
from ..files import find_named
from ..robots.model import ArmModel
from ..robots.settings import ArmSettings
from ..simulation import urdf
from ..simulation.fixtures import hulls
from ..simulation.geometry import Vector
from ..simulation.interface import Fingers, Gripper
from ..simulation.meshes import MESH_SUFFIXES, triangles
from ..simulation.urdf import Joint
from .poses import SMALLEST_WORKSPACE, Poses

GRIPPER_NAMES = re.compile(r"grip|finger|jaw|claw|knuckle|thumb", re.IGNORECASE)
"""Joints of these names are not of the arm."""
TOOL_NAMES = tuple(
    re.compile(pattern, re.IGNORECASE)
    for pattern in (r"grasp|tcp|tool_?cent|tool_?point", r"tool|(^|_)ee(_|f|$)|end_?eff", r"flange")
)
"""Frames that are taken for the tool, the best first."""
PARALLEL = 0.99
"""Cosine of the largest angle between two directions that count as the same."""
DOUBTED_SPEED, DOUBTED_ANGLE, DOUBTED_TRAVEL = 2 * pi, 4 * pi, 2.0
"""Speed in rad/s, angle in rad, and speed in m/s or way in m of a slide, from which a joint's limit is doubted."""
DOUBTED_MASS, DOUBTED_RADII, DOUBTED_LENGTH = 500.0, (0.001, 1.0), 3.5
"""Mass of a link in kg, least and largest radius of gyration of a link in m, and length of an arm in m."""
PAD_DEPTH = 0.01
"""Distance in m from the tips of the fingers to the tool centre point."""

FLOOR_CLEARANCE = 0.005
"""Height in m of the tips of a gripper above the floor, at its lowest."""


@dataclass(frozen=True)
class Proposal:
    """A model for a URDF, and in words what was assumed."""

    model: ArmModel
    tool_step: float
    """Largest in m that the joints' speeds allow at home, up to the default of every arm."""
    summary: str
    notes: tuple[str, ...]
    """What was assumed, one line each."""

    def code(self) -> dict[str, str]:
        """What the templates of a starter package say of this robot. Texts from the URDF are Python literals."""
        model = self.model
        given = [one for one in fields(model) if one.name != "urdf" and getattr(model, one.name)]
        lines = "\n".join(f"{one.name}={pformat(getattr(model, one.name), width=100)}," for one in given)
        edges = np.subtract(model.workspace.high, model.workspace.low)
        return {
            "summary": self.summary,
            "assumed": pformat(self.notes, width=112)[1:-1].replace("\n ", "\n    "),
            "imports": ", ".join(name for name in ("Box", "Fingers", "Gripper") if f"{name}(" in lines),
            "tool_step": repr(self.tool_step),
            "model": textwrap.indent(lines, " " * 8),
            "threshold": "0.05" if edges.min() > 0.2 else "0.02",
        }


def propose(path: Path, tool: str | None = None) -> Proposal:
    """A model of the arm in this URDF.

    Args:
        path: of the file.
        tool: the link of the tool frame; by default one of a usual name, or the end of the last link.

    Raises:
        PluginError: the file is not a robot that karolos can simulate, or not an arm that can point its tool down. The
            message names the joint or link.
    """
    loose = urdf.load(path, strict=False)
    if tool is not None and tool not in loose.carriers:
        raise PluginError(f"there is no link {tool!r}", where=str(path), hint=f"links: {', '.join(loose.carriers)}")
    arm = _arm(loose, path, tool)
    slides = tuple(one.name for one in loose.joints if not one.revolute and one.parent == arm[-1].child)
    slides = slides if len(slides) == 2 else ()
    moving = {joint.name for joint in arm} | {*slides}
    still = [joint for joint in loose.joints if joint.name not in moving]
    locked = {  # at 0, or at the end of the range that is nearest to 0
        joint.name: min(max(0.0, joint.lower), joint.upper) if joint.lower < joint.upper else 0.0
        for joint in still
        if joint.mimic is None or joint.mimic in moving
    }
    found = urdf.load(path, tuple(sorted(locked.items())), slides)
    joints = [joint for joint in found.joints if joint.revolute]
    base, last = joints[0].parent, joints[-1]
    merged = ", ".join(name for name, carrier in found.carriers.items() if carrier == base and name != base)
    hand = _hand(found, [joint for joint in found.joints if joint.name in slides])
    position, rotation, tool_note = _tool(found, path, last, hand, tool)
    usual: float = ArmSettings.model_fields["tool_step"].default
    poses = Poses(joints, (position, rotation), usual)
    best = poses.best()
    if best is None:
        raise PluginError(
            f"no box of {100 * SMALLEST_WORKSPACE:g} cm was found around the base that the tool reaches pointing down",
            where=str(path),
            hint="choose the tool with --tool LINK; the base stands on the floor with its z axis upwards",
        )
    low, high, dexterous = best.workspace.low, best.workspace.high, poses.dexterous(best)
    where = "none found: tasks whose goal is a pose refuse this robot"
    if dexterous is not None:
        turned = f"turned by {ArmModel.turn:g} rad and tilted by {ArmModel.tilt:g}"
        where = f"{_metres(dexterous.low)} to {_metres(dexterous.high)} m; the tool can be {turned} there"
    filled = ", ".join(f"{name} ({what} filled)" for name, what in hulls(found.robot).items())
    slow, heavy = f"{best.tool_step} m per control step instead of {usual}", ", ".join(found.corrected)
    notes = {
        f"base: {base}{merged and f' (with {merged})'}, at the origin of the world, on the floor z = 0": True,
        f"arm: {', '.join(joint.name for joint in joints)}": True,
        hand.note: True,
        f"locked: {', '.join(joint.name for joint in still)} do not move": still,
        f"inertia of {heavy}: no body can have it; its smaller moments are raised": heavy,
        **{f"doubted: {doubt}": True for doubt in doubts(found)},
        tool_note: True,
        f"home: tool at {_metres(best.tool)} m, pointing down; by inverse kinematics, far from joint limits": True,
        f"workspace: {_metres(low)} to {_metres(high)} m; the tool reaches it pointing down": True,
        f"dexterous: {where}": True,
        f"tool_step: {slow}: the joints are slower": best.tool_step < usual,
        f"collision: the convex hulls of {filled}": filled,
        "self-collisions: none; `self_collisions` in the ArmModel names pairs of links that shall collide": True,
    }
    model = ArmModel(
        urdf=path,
        home=best.home,
        workspace=best.workspace,
        dexterous=dexterous,
        tool=_vector(position),
        tool_rpy=_vector(urdf.roll_pitch_yaw(rotation)),
        fingers=hand.fingers,
        locked=locked,
    )
    width = hand.fingers and hand.fingers.gripper.width
    gripper = f"a gripper of two fingers that opens {100 * width:g} cm" if width else "without a gripper"
    summary = f"{len(joints)} joints, {poses.length:.2f} m long, {gripper}."
    return Proposal(model, best.tool_step, summary, tuple(note for note, holds in notes.items() if holds))


def doubts(found: urdf.Description) -> list[str]:
    """What the numbers of a URDF make one doubt, each in one line: units that are mixed up, and placeholders."""
    said: dict[str, list[str]] = defaultdict(list)
    for joint in found.joints:
        unit, most, fast, meant = "m", DOUBTED_TRAVEL, DOUBTED_TRAVEL, "millimetres"
        if joint.revolute:
            unit, most, fast, meant = "rad", DOUBTED_ANGLE, DOUBTED_SPEED, "degrees"
        if (far := max(-joint.lower, joint.upper)) > most:
            said[f"to {far:g} {unit}; are these {meant}?"].append(f"joint {joint.name}")
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
    length = sum(float(np.linalg.norm(joint.origin)) for joint in found.joints if joint.revolute)
    if length > DOUBTED_LENGTH:
        said["in other units than metres?"].append(f"a length of {length:.3g} m")
    return [f"{', '.join(of)}: {what}" for what, of in said.items()]


def propose_gripper(path: Path, tool: str | None = None) -> tuple[dict[str, str], tuple[str, ...]]:
    """What the template of a gripper says of this URDF, and what was assumed.

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


def _metres(place: Sequence[float] | Array) -> str:
    return " ".join(f"{round(float(value), 3) + 0.0:.3f}" for value in place)


def _vector(values: Sequence[float] | Array) -> Vector:
    x, y, z = (round(float(value), 6) + 0.0 for value in values)
    return x, y, z


def _arm(found: urdf.Description, path: Path, tool: str | None) -> list[Joint]:
    """The turning joints from the base to the wrist: above the tool, or of the longest chain."""
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
        if len(longest) > 1 and len(longest[0]) - len(arm) > 2:  # shorter branches are fingers
            first = [joints[one[len(arm)]] for one in longest]
            raise PluginError(
                f"two arms begin here, with joints {', '.join(joint.name for joint in first)}",
                where=f"{path}: link {first[0].parent}",
                hint="choose one with --tool LINK, a link at its end",
            )
    for name in arm:
        if joints[name].mimic is not None:
            what = f"it mimics {joints[name].mimic}; karolos drives every joint of an arm by itself"
            raise PluginError(what, where=f"{path}: joint {name}")
    if len(arm) < 5:
        raise PluginError(
            f"an arm of {len(arm)} turning joints ({', '.join(arm) or 'none'})",
            where=str(path),
            hint="with five or more it can point its tool down at any place; --tool LINK chooses its end",
        )
    return [joints[name] for name in arm]


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
            hint="make them fixed in a copy of the URDF to use the robot without its gripper",
        )
    pads = [_points_of(found.robot, one.child) @ np.transpose(one.rotation) + one.origin for one in pair]
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

    It is the frame that the user named, or one of a usual name that lies between the fingers; else the tips of the
    fingers, or the end of the last link along its joint's axis.
    """
    frames = {name: found.frames[name] for name, one in found.carriers.items() if one == last.child}
    usual = dict.fromkeys(one for like in TOOL_NAMES for one in frames if like.search(one) and one != last.child)
    name = named or next(iter(usual), None)
    if name is not None and name not in frames:
        raise PluginError(f"fixed joints do not hold it to {last.child}", where=f"{path}: link {name}")
    place, turn = frames[name] if name is not None else (np.zeros(3), np.eye(3))
    tips, axis, shapes = hand.tips, np.array(last.axis), _points_of(found.robot, last.child)
    approach, what = turn[:, 2], f"the frame {name}"
    if name is None or (named is None and abs(approach @ axis) < PARALLEL):
        before = np.transpose(last.rotation) @ last.origin  # from the joint before to this one
        middle, ends = ((points.min(0, initial=0.0) + points.max(0, initial=0.0)) / 2 for points in (tips, shapes))
        hints = [along for hint in (middle, place, before, ends) if abs(along := hint @ axis) > 0.005]
        approach = -axis if hints and hints[0] < 0 else axis
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
    elif name is None:
        place, what = approach * max(0.0, float((shapes @ approach).max(initial=0.0))), "the end of its shapes"
    x = min(turn.T, key=lambda column: abs(float(column @ approach)))
    x = np.cross(hand.across, approach) if len(tips) else x - (x @ approach) * approach
    x = x / np.linalg.norm(x)
    note = f"tool: {what}, {_metres(place)} m in {last.child}; it approaches along {_metres(approach)}"
    if others := [one for one in usual if named is None and what != f"the frame {one}"]:
        note += f"; not {', '.join(others)}, which --tool LINK chooses"
    return place, np.column_stack([x, np.cross(approach, x), approach]), note


def _points_of(robot: Element, link: str) -> Array:
    """Points (n, 3) that span the collision shapes of a link, or its visual ones, in its frame in m."""
    element = next(one for one in robot.findall("link") if one.get("name") == link)
    found = [np.zeros((0, 3))]
    for shape in element.findall("collision") or element.findall("visual"):
        translation, rotation = urdf.origin_of(shape)
        found += [_corners(one) @ rotation.T + translation for one in shape.findall("geometry/*")]
    return np.vstack(found)


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
    """A URDF whose meshes are in the folder `meshes` beside it, and the files to copy there by their new names."""
    text, files, robot = urdf.text_of(path), dict[str, Path](), urdf.read(path)
    for shape in [one for link in robot.iter("link") for one in link.findall("visual")]:
        if any(mesh.get("filename", "").lower().endswith(".dae") for mesh in shape.iter("mesh")):
            shape.clear()  # such a link is drawn as it collides
    for number, name in enumerate(sorted({mesh.get("filename", "") for mesh in robot.iter("mesh")})):
        mesh = find_named(name, path.parent)
        if mesh is not None and mesh.suffix.lower() in MESH_SUFFIXES:
            new = next((to for to, file in files.items() if file == mesh), f"meshes/{number}_{mesh.name}")
            files[new] = mesh
            text = quoteattr(new).join(re.split(rf"""(["']){re.escape(escape(name))}\1""", text)[::2])
    return text, files
