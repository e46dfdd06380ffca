"""A robot plugin proposed from somebody's URDF: what the file does not say is computed, and noted as an assumption."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, product
from math import pi
from pathlib import Path

import numpy as np

from ..core import Array
from ..core.seeding import SeedTree
from ..errors import PluginError
from ..robots.arm import Arm, ArmModel, ArmSettings
from ..simulation import urdf
from ..simulation.engines import default_engine, make_world
from ..simulation.geometry import Box, Vector
from ..simulation.interface import Fingers, Gripper
from ..simulation.urdf import Joint
from .meshes import points_of
from .poses import SMALLEST, Poses

GRIPPER_NAMES = re.compile(r"grip|finger|jaw|claw|knuckle|thumb", re.IGNORECASE)
"""Joints of these names are not of the arm."""
TOOL_NAMES = tuple(
    re.compile(pattern, re.IGNORECASE)
    for pattern in (r"grasp|tcp|tool_?cent|tool_?point", r"tool|(^|_)ee(_|f|$)|end_?eff", r"flange")
)
"""Frames that are taken for the tool, the best first."""
ALONG = 0.99
"""Cosine of the largest angle between two directions that count as the same."""
FAST = 2 * pi
"""Speed in rad/s from which a joint's limit is doubted."""
PAD_DEPTH = 0.01
"""Distance in m from the tips of the fingers to the tool centre point."""
TOOL_STEP: float = ArmSettings.model_fields["tool_step"].default


@dataclass(frozen=True)
class Proposal:
    """A model for a URDF, and in words what was assumed."""

    model: ArmModel
    joints: tuple[str, ...]
    tool_step: float
    """Largest in m that the joints' speeds allow at home, up to the default of every arm."""
    length: float
    """Of the arm from its second joint, in m."""
    notes: list[str] = field(default_factory=list)
    """What was assumed, one line each."""

    def texts(self) -> dict[str, str]:
        """What the templates of a starter package say of this robot."""
        model = self.model
        summary = f"{len(model.home)} joints, {self.length:.2f} m long, "
        more, imports, settings = (
            [],
            [],
            ["    class Settings(ArmSettings):", '        """The settings of every arm."""'],
        )
        if (fingers := model.fingers) is not None:
            summary += f"a gripper of two fingers that opens {100 * fingers.gripper.width:g} cm."
            imports += ["Fingers", "Gripper"]
            more += [
                "fingers=Fingers(",
                *(
                    f"    {key}={_code(getattr(fingers, key))},"
                    for key in ("joints", "links", "travel", "open_at_zero")
                ),
                f"    gripper={fingers.gripper},",
                "),",
            ]
        else:
            summary += "without a gripper."
        if model.self_collisions:
            more += ["self_collisions=(", *(f"    {_code(pair)}," for pair in model.self_collisions), "),"]
        if model.locked:
            more += ["locked={", *(f"    {_code(joint)}: {at!r}," for joint, at in model.locked.items()), "},"]
        if self.tool_step < TOOL_STEP:
            settings[-1:] = [
                '        """The settings of every arm, with a shorter step."""',
                "",
                "        tool_step: float = Setting(",
                f"            {self.tool_step}, gt=0, le=0.2, "
                'description="largest change of the tool position per control step, m"',
                "        )",
            ]
        notes = [f"* {note}" for note in self.notes]
        return {
            "summary": summary,
            "file": model.urdf.name,
            "assumed": "\n".join(_wrapped(notes)),
            "about": "\n".join(["", "## What was assumed", *_wrapped(notes), ""]),
            "imports": "".join(f", {one}" for one in imports),
            "settings_import": "" if self.tool_step >= TOOL_STEP else "from pydantic import Field as Setting\n\n",
            "settings": "\n".join(settings),
            "home": "".join(
                f"            {angle!r},  # {joint}\n" for angle, joint in zip(model.home, self.joints, strict=True)
            ),
            "low": _code(model.workspace.low),
            "high": _code(model.workspace.high),
            "tool": _code(model.tool),
            "tool_rpy": _code(model.tool_rpy),
            "threshold": "0.05" if min(np.subtract(model.workspace.high, model.workspace.low)) > 0.2 else "0.02",
            "more": "".join(f"        {line}\n" for line in more),
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
    notes: list[str] = []
    loose = urdf.load(path, strict=False)
    if tool is not None and tool not in loose.carriers:
        raise PluginError(f"there is no link {tool!r}", where=str(path), hint=f"links: {', '.join(loose.carriers)}")
    arm = _arm(loose, path, tool)
    wrist = arm[-1].child
    slides = _slides(loose, wrist)
    locked = {
        joint.name: _rest(joint)
        for joint in loose.joints
        if joint not in arm
        and joint.name not in slides
        and (joint.mimic is None or joint.mimic in {one.name for one in arm})
    }
    found = urdf.load(path, tuple(sorted(locked.items())), slides)
    joints = [joint for joint in found.joints if joint.revolute]
    fingers, pads, across = _fingers(found, slides, notes)
    if fingers is None:
        notes.append("gripper: no pair of sliding fingers, so that tasks which grasp do not work")
    if held := [joint.name for joint in loose.joints if joint not in arm and joint.name not in slides]:
        notes.append(f"locked: {', '.join(held)} do not move")
    notes += [f"inertia of {link}: no body can have it; its smaller moments are raised" for link in found.corrected]
    if fast := [joint.name for joint in joints if joint.velocity > FAST]:
        notes.append(
            f"speed: the URDF lets {', '.join(fast)} turn faster than a turn per second; compare the data sheet"
        )
    base = joints[0].parent
    notes.insert(0, f"base: {_names(found, base)}, at the origin of the world, on the floor z = 0")
    notes.insert(1, f"arm: {', '.join(joint.name for joint in joints)}")
    position, rotation, note = _tool(path, found, joints[-1], (across, *pads), tool)
    notes.append(note)
    poses = Poses(joints, (position, rotation))
    best = poses.best(TOOL_STEP)
    if best is None or best.edge < SMALLEST:
        raise PluginError(
            f"no box of {100 * SMALLEST:g} cm was found around the base that the tool reaches pointing down",
            where=str(path),
            hint="choose the tool with --tool LINK; the base stands on the floor with its z axis upwards",
        )
    home, tool_step, box, start = best
    notes.append(f"home: tool at {_metres(start)} m, pointing down; by inverse kinematics, far from joint limits")
    notes.append(f"workspace: {_metres(box.low)} to {_metres(box.high)} m; the tool reaches it pointing down")
    if tool_step < TOOL_STEP:
        notes.append(f"tool_step: {tool_step} m per control step instead of {TOOL_STEP}, because the joints are slower")
    model = ArmModel(
        urdf=path,
        home=home,
        workspace=box,
        tool=_vector(position),
        tool_rpy=_vector(urdf.roll_pitch_yaw(rotation)),
        fingers=fingers,
        locked=locked,
    )
    model = replace(model, self_collisions=_self_collisions(model, found))
    notes.append(f"self-collisions: {len(model.self_collisions)} pairs of links that do not touch in the workspace")
    return Proposal(model, tuple(joint.name for joint in joints), tool_step, poses.length, notes)


def _code(value: object) -> str:
    """A value as ruff writes it."""
    return repr(value).replace("'", '"')


def _wrapped(lines: Sequence[str]) -> list[str]:
    return [part for line in lines for part in textwrap.wrap(line, 118, subsequent_indent="  ", break_on_hyphens=False)]


def _metres(place: Sequence[float] | Array) -> str:
    return " ".join(f"{round(float(value), 3) + 0.0:.3f}" for value in place)


def _vector(values: Sequence[float] | Array) -> Vector:
    x, y, z = (round(float(value), 6) + 0.0 for value in values)
    return x, y, z


def _names(found: urdf.Description, link: str) -> str:
    """A link and those that are merged into it."""
    others = [name for name, carrier in found.carriers.items() if carrier == link and name != link]
    return f"{link} (with {', '.join(others)})" if others else link


def _rest(joint: Joint) -> float:
    """The position at which a locked joint is held: 0, or the end of its range that is nearest to 0."""
    return min(max(0.0, joint.lower), joint.upper) if joint.lower < joint.upper else 0.0


def _arm(found: urdf.Description, path: Path, tool: str | None) -> list[Joint]:
    """The turning joints of the arm, from the base to the wrist. Joints that slide on the way are left out."""
    leaders = {joint.mimic for joint in found.joints}
    usable = [
        joint
        for joint in found.joints
        if joint.mimic is None and joint.name not in leaders and not GRIPPER_NAMES.search(joint.name)
    ]
    above = {joint.child: joint for joint in found.joints}
    arm: list[Joint] = []

    def depth(joint: Joint) -> int:
        return joint.revolute + max((depth(other) for other in usable if other.parent == joint.child), default=0)

    if tool is not None:
        link = found.carriers[tool]
        while link in above:
            arm.insert(0, above[link])
            link = above[link].parent
        while arm and arm[-1] not in usable:  # the tool link is on a finger
            arm.pop()
    else:
        link = next((joint.parent for joint in found.joints if joint.parent not in above), "")
        while children := [joint for joint in usable if joint.parent == link and depth(joint)]:
            deepest = max(map(depth, children))
            first, *others = (joint for joint in children if depth(joint) == deepest)
            if others and deepest <= 2:  # fingers
                break
            if others:
                raise PluginError(
                    f"two arms begin here, with joints {', '.join(joint.name for joint in (first, *others))}",
                    where=f"{path}: link {link}",
                    hint="choose one with --tool LINK, a link at its end",
                )
            arm.append(first)
            link = first.child
    arm = [joint for joint in arm if joint.revolute]
    for joint in arm:
        if joint.mimic is not None:
            raise PluginError(
                f"it mimics {joint.mimic}; karolos drives every joint of an arm by itself",
                where=f"{path}: joint {joint.name}",
            )
    if len(arm) < 5:
        names = ", ".join(joint.name for joint in arm) or "none"
        raise PluginError(
            f"an arm of {len(arm)} turning joints ({names})",
            where=str(path),
            hint="with five or more it can point its tool down at any place; --tool LINK chooses its end",
        )
    return arm


def _slides(found: urdf.Description, wrist: str) -> tuple[str, ...]:
    """The two prismatic joints of a parallel gripper; empty if there are not exactly two on the wrist."""
    slides = [joint for joint in found.joints if not joint.revolute and joint.parent == wrist]
    return tuple(joint.name for joint in slides) if len(slides) == 2 else ()


def _fingers(
    found: urdf.Description, slides: tuple[str, ...], notes: list[str]
) -> tuple[Fingers | None, list[Array], Array]:
    """The gripper of two sliding fingers, the points of each in the frame of the last link, and the axis of sliding."""
    pair = [joint for joint in found.joints if joint.name in slides]
    if not pair:
        return None, [], np.zeros(3)
    frames = [np.array(joint.rotation) for joint in pair]
    first, second = (frame @ np.array(joint.axis) for frame, joint in zip(frames, pair, strict=True))
    points = [
        points_of(found.robot, joint.child) @ frame.T + joint.origin for joint, frame in zip(pair, frames, strict=True)
    ]
    if first @ second > -0.99:
        raise PluginError(
            "the fingers do not slide in opposite directions",
            where=f"joints {slides[0]}, {slides[1]}",
            hint="make them fixed in a copy of the URDF to use the robot without its gripper",
        )
    travel = min(joint.upper for joint in pair)
    middles = [
        (group.min(0) + group.max(0)) / 2 if len(group) else np.array(joint.origin)
        for group, joint in zip(points, pair, strict=True)
    ]
    open_at_zero = bool((middles[0] - middles[1]) @ first < 0)
    gap = 0.0
    if len(points[0]) and len(points[1]):
        side = -1 if open_at_zero else 1
        between = float((points[0] @ (side * first)).min() - (points[1] @ (side * first)).max())
        gap = max(0.0, between - (2 * travel if open_at_zero else 0.0))
    width = round(2 * travel + (gap if gap > 0.005 else 0.0), 4)
    force, speed = min(joint.effort for joint in pair), min(joint.velocity for joint in pair)
    notes.append(
        f"gripper: {slides[0]} and {slides[1]}, {'closing' if open_at_zero else 'opening'} from 0 to {travel:g} m, "
        f"{width:g} m wide when open; {force:g} N and {speed:g} m/s are the limits in the URDF; "
        "pad friction 1 as of rubber"
    )
    gripper = Gripper(width=width, force=force, speed=speed, pad_friction=1.0)
    joints, links = (slides[0], slides[1]), (pair[0].child, pair[1].child)
    return Fingers(joints=joints, links=links, travel=travel, open_at_zero=open_at_zero, gripper=gripper), points, first


def _frames(path: Path, link: str) -> dict[str, tuple[Array, Array]]:
    """Translation and rotation, in the frame of `link`, of all links that fixed joints hold to it."""
    frames = {link: (np.zeros(3), np.eye(3))}
    fixed = [joint for joint in urdf.read(path).findall("joint") if joint.get("type") == "fixed"]
    for _ in fixed:
        for joint in fixed:
            parent, child = urdf.link_of(joint, "parent"), urdf.link_of(joint, "child")
            if parent in frames:
                (translation, rotation), (offset, turn) = frames[parent], urdf.origin_of(joint)
                frames[child] = translation + rotation @ offset, rotation @ turn
    return frames


def _tool(
    path: Path, found: urdf.Description, last: Joint, hand: Sequence[Array], named: str | None
) -> tuple[Array, Array, str]:
    """Position and rotation of the tool in the frame of the last link, z along the direction of approach, and a note.

    Args:
        path: of the URDF.
        found: its description.
        last: joint of the arm.
        hand: axis along which the fingers slide, 0 without a gripper, and points of each finger, in the frame of the
            last link.
        named: the tool frame, if the user names it.
    """
    frames = _frames(path, last.child)
    name = named or next(
        (name for pattern in TOOL_NAMES for name in frames if pattern.search(name) and name != last.child), ""
    )
    if named is not None and named not in frames:
        raise PluginError(f"fixed joints do not hold it to {last.child}", where=f"{path}: link {named}")
    place, turn = frames.get(name, (None, np.eye(3)))
    across, *pads = hand
    shapes, tips = np.vstack([points_of(found.robot, last.child), *pads]), np.vstack([np.zeros((0, 3)), *pads])
    axis = np.array(last.axis)
    middle = np.zeros(3)
    if len(tips):
        middle = np.mean([(group.min(0) + group.max(0)) / 2 for group in pads if len(group)], axis=0)
    if named is not None or (place is not None and abs(turn[:, 2] @ axis) > ALONG):
        approach = turn[:, 2]
    elif len(tips):
        sides = [side * unit for unit in np.eye(3) for side in (1, -1) if abs(unit @ across) < 0.1]
        approach = max(sides, key=lambda side: float(side @ middle), default=axis)
    else:
        beyond = 0.0 if place is None else float(place @ axis)
        approach = axis * (float(np.sign(beyond)) if abs(beyond) > 0.005 else _outwards(last, shapes))
    if abs(approach @ across) > 1 - ALONG + 0.1:
        raise PluginError(
            "the fingers slide along the direction of approach",
            where=f"{path}: link {last.child}",
            hint="name the tool frame, whose z axis is this direction, with --tool LINK",
        )
    depths = tips @ approach
    if place is not None and (named is not None or not len(tips) or depths.min() < place @ approach < depths.max()):
        what = f"the frame {name}"
    elif len(tips):
        tip = float(depths.max()) - PAD_DEPTH
        place, what = middle + (tip - middle @ approach) * approach, f"{PAD_DEPTH:g} m from the tips of the fingers"
    else:
        place, what = approach * max(0.0, float((shapes @ approach).max(initial=0.0))), "the end of its shapes"
    x = np.cross(across, approach) if across.any() else min(turn.T, key=lambda column: abs(float(column @ approach)))
    x = x - (x @ approach) * approach
    x = x / np.linalg.norm(x)
    note = f"tool: {what}, {_metres(place)} m in {last.child}; it approaches along {_metres(approach)}"
    return place, np.column_stack([x, np.cross(approach, x), approach]), note


def _outwards(last: Joint, points: Array) -> float:
    """The side, 1 or -1, to which the last joint's axis leaves the arm."""
    axis = np.array(last.axis)
    before = float((np.array(last.rotation) @ axis) @ np.array(last.origin))
    if abs(before) > 0.005 or not len(points):
        return -1.0 if before < 0 else 1.0
    ends = points @ axis
    return 1.0 if ends.max() >= -ends.min() else -1.0


def _self_collisions(model: ArmModel, found: urdf.Description) -> tuple[tuple[str, str], ...]:
    """Pairs of links at least three joints apart that do not touch at home and at the corners of the workspace."""
    depth = {joint.child: number for number, joint in enumerate(found.joints, 1)}
    wrist = sum(joint.revolute for joint in found.joints)
    for joint in found.joints:
        if not joint.revolute:
            depth[joint.child] = wrist + 1
    depth[found.joints[0].parent] = 0
    shaped = {link.get("name", "") for link in found.robot.findall("link") if link.find("collision") is not None}
    pairs = [
        (distal, proximal)
        for proximal, distal in combinations(sorted(depth, key=depth.__getitem__), 2)
        if depth[distal] - depth[proximal] >= 3 and {distal, proximal} <= shaped
    ]

    class Proposed(Arm):
        Settings = ArmSettings

    Proposed.model = model
    robot, world = Proposed(ArmSettings.model_validate({})), make_world(default_engine())
    try:
        robot.prepare(gripper=model.fingers is not None, period=world.period)
        robot.build(world)
        links = {**robot.body.links(), found.joints[0].parent: -1}
        free = set(pairs)
        for place in (robot.home, *_corners(model.workspace)):
            robot.reset(SeedTree(0).generator())
            robot.place_tool(place, 1.0)
            for pair in sorted(free):
                robot.body.collide_only([(links[pair[0]], links[pair[1]])])
                world.update_contacts()
                if world.contacts(robot.body, robot.body, links[pair[0]]):
                    free.discard(pair)
    finally:
        world.close()
    return tuple(pair for pair in pairs if pair in free)


def _corners(box: Box) -> Iterator[Vector]:
    yield from product(*zip(box.low, box.high, strict=True))
