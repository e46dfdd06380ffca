"""Mounts a gripper on an arm, and computes the numbers that depend on both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import product
from math import atan2, cos, dist, sin
from pathlib import Path

import numpy as np

from ..core import Array
from ..errors import UsageError
from ..registry import load
from ..simulation import urdf
from ..simulation.geometry import Box, Vector
from ..simulation.kinematics import Chain, downward
from ..simulation.urdf import Joint, Mount
from .grippers.parallel import GripperModel
from .model import FINGERS, ArmModel

STEPS_DOWN = 3.0
"""`ArmModel.steps_down` with another gripper: a Panda brakes slowly and would press broad pads into the floor."""
REACHED = 2e-3
"""Largest error of inverse kinematics, in m for the position and without unit for the approach."""


def mounted(model: ArmModel, name: str | None) -> ArmModel:
    """The model with this gripper at the arm's flange; None: with the arm's own.

    The joints at home stay, and the tool's position follows. The workspace begins where the gripper meets the floor.
    With a foreign gripper it shrinks to the part that the tool reaches.

    Raises:
        UsageError: the gripper is unknown, or the arm cannot use it.
    """
    own, flange = model.gripper, model.flange
    if flange is None or name is own is None:
        if name is not None:
            hint = "its own is part of its URDF; an arm with a `flange` in its ArmModel takes another"
            raise UsageError(f"this arm cannot take the gripper {name}", setting="robot.gripper", hint=hint)
        return replace(model, self_collisions=_pairs(model, model.fingers.links if model.fingers else ()))
    chosen = name or own or ""
    gripper: GripperModel = load("grippers", chosen).model
    if model.payload is not None and gripper.mass > model.payload:
        what = f"{chosen} weighs {gripper.mass:.2f} kg, more than the payload of {model.payload:g} kg"
        raise UsageError(what, setting="robot.gripper", hint="choose a lighter gripper")
    built_in = model.urdf.parent == Path(__file__).parent / "urdf"  # a foreign ur5.urdf does not count
    path = gripper.variants.get(model.urdf.stem, gripper.urdf) if built_in else gripper.urdf
    mount = Mount(chosen, path, flange.link, flange.position, flange.rpy)
    fingers, links, joints = gripper.fingers, tuple[str, ...](), tuple[str, ...]()
    if fingers is not None:
        (a, b), (c, d) = fingers.links, fingers.joints
        links, joints = (mount.named(a), mount.named(b)), (mount.named(c), mount.named(d))
        fingers = replace(fingers, links=links, joints=joints)
    whole = replace(
        model,
        tool=_placed(flange.position, urdf.rotation_matrix(*flange.rpy), gripper.tool),
        fingers=fingers,
        cup=gripper.cup,
        mount=mount,
        gripper_mass=gripper.mass,
        self_collisions=_pairs(model, links),
        tool_rpy=model.tool_rpy if own else flange.rpy,
    )
    if name in (None, own):
        return whole
    arm = tuple(joint for joint in whole.description.joints if joint.revolute)
    x, y, _ = model.workspace.low
    box = Box((x, y, gripper.least_height), model.workspace.high)
    box = _reached(arm, (whole.tool, whole.tool_rpy, model.floor), whole.home, box)
    whole = replace(whole, workspace=box, dexterous=None, steps_down=STEPS_DOWN)
    if model.dexterous is None or own is None or name not in model.turn_with:
        return whole
    before: GripperModel = load("grippers", own).model
    turned = _turned(model.dexterous, gripper.tool[2] - before.tool[2], model.tilt, box)
    return replace(whole, dexterous=turned, turn=model.turn_with[name])


def _pairs(model: ArmModel, fingers: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """The pairs of links that collide, with each finger where the model says FINGERS."""
    ends = ((fingers if link == FINGERS else (link,) for link in pair) for pair in model.self_collisions)
    return tuple((first, second) for pair in ends for first, second in product(*pair))


def _placed(origin: Vector, rotation: Array, position: Vector) -> Vector:
    """A position in another frame, to 1e-12 m, so that the sum of decimals is a decimal."""
    x, y, z = (round(float(value), 12) + 0.0 for value in np.array(origin) + rotation @ position)
    return x, y, z


@cache
def _reached(joints: tuple[Joint, ...], frames: tuple[Vector, Vector, float], home: tuple[float, ...], box: Box) -> Box:
    """The box, shrunk towards the tool at home until the tool, pointing down, reaches all of it. It stays on the floor.

    Args:
        joints: of the arm.
        frames: position of the tool in the frame of the last link, in m, its rotation there, and `ArmModel.floor`.
        home: joint positions in rad.
        box: the largest box, in m.
    """
    tool, rpy, floor = frames
    chain = Chain(joints, (np.array(tool), urdf.rotation_matrix(*rpy)), (0.0, 0.0, -floor))
    at = chain.forward(home).tool
    yaw = atan2(at.x[1], at.x[0])
    for share in np.linspace(1.0, 0.5, 26):
        low, high = (np.add(at.position, share * np.subtract(end, at.position)) for end in (box.low, box.high))
        inner = box if share == 1 else _inside(np.array([*low[:2], box.low[2]]), high)
        corners = product(*zip(inner.low, inner.centre, inner.high, strict=True))
        if inner.contains(at.position) and all(_reaches(chain, joints, home, place, yaw) for place in corners):
            return inner
    hint = "it needs another home pose: a robot of its own, with its own `home` and `workspace`"
    what = "with this gripper the tool reaches less than half of the workspace"
    raise UsageError(what, setting="robot.gripper", hint=hint)


def _reaches(
    chain: Chain, joints: tuple[Joint, ...], home: tuple[float, ...], place: Sequence[float], yaw: float
) -> bool:
    """Whether the tool, pointing down, gets from home to a place within the limits of the joints."""
    x, y, z = place
    target, pose = downward((x, y, z), yaw), np.array(home)
    low, high = (np.array([getattr(joint, end) for joint in joints]) for end in ("lower", "upper"))
    for _ in range(60):
        now = chain.forward(pose)
        if max(dist(now.tool.position, place), dist(now.tool.z, target.z)) < REACHED:
            return True
        change = chain.step(now, target, 0.1 * (np.array(home) - pose))
        pose = np.clip(pose + np.clip(change, -0.5, 0.5), low, high)
    return False


def _turned(box: Box, longer: float, tilt: float, within: Box) -> Box | None:
    """The part of a workspace in which the tool of a gripper that is `longer`, in m, can be tilted by `tilt`, in rad.

    With an unchanged flange the tool is further along its approach by `longer`. The result is the part that all tilts
    have in common; None if there is none.
    """
    aside, far, near = abs(longer) * sin(tilt), max(longer, longer * cos(tilt)), min(longer, longer * cos(tilt))
    low = np.maximum(np.add(box.low, (aside, aside, -near)), within.low)
    high = np.minimum(np.subtract(box.high, (aside, aside, far)), within.high)
    if (low >= high).any():
        return None
    return _inside(low, high)


def _inside(low: Array, high: Array) -> Box:
    """The box between two corners, rounded inwards to millimetres."""
    (a, b, c), (d, e, f) = np.ceil(np.round(1000 * low, 6)) / 1000, np.floor(np.round(1000 * high, 6)) / 1000
    return Box((float(a), float(b), float(c)), (float(d), float(e), float(f)))
