"""Random arms: families of real arms, with lengths, limits, speeds, masses and torques sampled by a number."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from pydantic import Field as Setting

from ..core import Array
from ..core.seeding import Generator, SeedTree
from ..core.settings import LATER
from ..errors import MachineError, PluginError, UsageError
from ..simulation.geometry import UPRIGHT, Quaternion, Vector, quaternion_of
from ..simulation.parts import link_element, place_element
from ..simulation.shapes import Capsule
from ..system.files import fingerprint, user_cache, write_whole, writing
from .arm import Arm
from .from_file import FromFile, proposal_of
from .model import ArmModel
from .repair import Repair
from .settings import ArmSettings

SCALE, OTHERWISE = (0.6, 1.5), (0.8, 1.2)
"""Size of an arm relative to a UR5, and variation of its lengths relative to its family at this size."""
SPEED, LIMIT = (1.6, 4.0), (2.0, 3.1)
"""Speed of a joint in rad/s, and its range to each side in rad."""
DENSITY, STRENGTH = (12.0, 45.0), (0.8, 1.8)
"""Mass of an arm per square of its length in kg/m2, and torques relative to three times the torque that holds it
stretched out."""
GRIPPERS = "robotiq_2f85", "franka_hand"
"""Gripper of the arms if the spec names none."""
ROOM, SLOWEST = (0.12, 0.2, 0.15), 0.01
"""Smallest edges of the workspace and smallest step of the tool, in m, of an accepted arm."""
ATTEMPTS = 40
"""Number of arms that are sampled until one can work."""
BULK = 0.07
"""Radius of a link per length of the arm."""
X, Y, Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)


class ArmSegment(NamedTuple):
    """A joint of an arm with a UR5's size, and the way of its link with all joints at 0."""

    axis: tuple[int, int, int]
    way: Vector
    """Vector from this joint to the next, or to the flange, in m, along the axes of the base."""


FAMILIES: dict[str, tuple[tuple[int, int, int], tuple[ArmSegment, ...]]] = {
    "offset wrist": (  # as UR, Doosan, xArm 6: three parallel axes
        Y,
        (
            ArmSegment(Z, (0.0, 0.13, 0.0)),
            ArmSegment(Y, (0.0, -0.12, 0.42)),
            ArmSegment(Y, (0.0, 0.0, 0.39)),
            ArmSegment(Y, (0.0, 0.1, 0.0)),
            ArmSegment(Z, (0.0, 0.0, 0.095)),
            ArmSegment(Y, (0.0, 0.08, 0.0)),
        ),
    ),
    "spherical wrist": (  # as ABB, KUKA KR, Puma: three axes that meet
        X,
        (
            ArmSegment(Z, (0.1, 0.0, 0.1)),
            ArmSegment(Y, (0.0, 0.0, 0.4)),
            ArmSegment(Y, (0.15, 0.0, 0.04)),
            ArmSegment(X, (0.25, 0.0, 0.0)),
            ArmSegment(Y, (0.05, 0.0, 0.0)),
            ArmSegment(X, (0.07, 0.0, 0.0)),
        ),
    ),
    "seven joints": (  # as Panda, iiwa, Gen3: a redundant one
        Z,
        (
            ArmSegment(Z, (0.0, 0.0, 0.15)),
            ArmSegment(Y, (0.0, 0.0, 0.2)),
            ArmSegment(Z, (0.06, 0.0, 0.16)),
            ArmSegment(Y, (-0.06, 0.0, 0.2)),
            ArmSegment(Z, (0.0, 0.0, 0.18)),
            ArmSegment(Y, (0.06, 0.0, 0.08)),
            ArmSegment(Z, (0.0, 0.0, 0.08)),
        ),
    ),
}
"""The direction in which the flange points with all joints at 0, and the joints from the base on."""


class RandomArm(Arm):
    """An arm sampled from three families, to train policies that do not depend on the arm. `arm` is its number.

    Training can sample it per episode: `randomization: {robot.arm: {name: choice, values: [0, 1, 2, 3]}}`. Each value
    needs a world in each environment. Home, workspace and accelerations are computed as for an arm from a file.
    """

    class Settings(ArmSettings):
        """The settings of every arm, and its number."""

        arm: int = Setting(ge=0, le=1_000_000, description="number of the arm; each number gives another arm")
        turning: bool = Setting(
            False, json_schema_extra=LATER, description="only arms that can turn their tool, as poses ask for"
        )

    @classmethod
    def bare_model(cls, settings: ArmSettings) -> ArmModel:
        assert isinstance(settings, cls.Settings)
        return _model(settings.arm, settings.gripper, settings.turning)


@lru_cache(maxsize=256)
def _model(arm: int, gripper: str | None, turning: bool = False) -> ArmModel:
    """The first arm of this number that can work: its tool points down and moves fast enough in a large workspace.

    With `turning` the tool can also be turned in a part of the workspace.

    Raises MachineError if there is no folder for caches, UsageError if none of the arms of this number can.
    """
    source = hashlib.sha256(str(fingerprint(Path(__file__), follow=False)).encode()).hexdigest()[:12]
    try:
        folder = user_cache() / "robots" / "random" / source
    except RuntimeError:
        raise MachineError("there is no folder for caches", setting="robot.arm", hint="set XDG_CACHE_HOME") from None
    for attempt, draws in enumerate(_draws(arm)):
        gripper = gripper or GRIPPERS[int(draws.integers(len(GRIPPERS)))]
        path, refused = (folder / f"{arm}-{attempt}-{gripper}.{end}" for end in ("urdf", "refused"))
        if refused.exists():
            continue
        if not path.exists():
            _write(path, draws)
        try:
            model = proposal_of(FromFile.Settings.model_validate({"file": str(path), "gripper": gripper})).model
        except PluginError:
            model = None
        if model is not None and _works(model):
            if turning and model.dexterous is None:
                continue
            return model
        write_whole(refused, "", durable=False)
    raise UsageError(f"none of {ATTEMPTS} sampled arms can work", setting="robot.arm", hint="choose another number")


def _draws(arm: int) -> Iterator[Generator]:
    for attempt in range(ATTEMPTS):
        yield SeedTree(arm).child(f"random arm {attempt}").generator()


def _works(model: ArmModel) -> bool:
    edges = np.subtract(model.workspace.high, model.workspace.low)
    return bool((edges >= ROOM).all()) and (model.tool_step or SLOWEST) >= SLOWEST


def _write(path: Path, draws: Generator) -> None:
    """Sample an arm and write its URDF."""
    family = list(FAMILIES)[int(draws.integers(len(FAMILIES)))]
    facing, pieces = FAMILIES[family]
    scale = draws.uniform(*SCALE)
    ways = [scale * draws.uniform(*OTHERWISE) * np.array(piece.way) for piece in pieces]
    pedestal = scale * draws.uniform(0.08, 0.3)  # of the second joint above the base
    length = float(sum(map(np.linalg.norm, ways[1:])))
    robot = Element("robot", name=family.replace(" ", "_"))
    thick = BULK * length
    robot.append(_link("base", np.array((0.0, 0.0, pedestal)), thick))
    before, place = "base", np.array((0.0, 0.0, pedestal))
    for number, (piece, way) in enumerate(zip(pieces, ways, strict=True), 1):
        name, radius = f"link_{number}", thick * (1 - 0.6 * number / len(pieces))
        joint = SubElement(robot, "joint", name=f"joint_{number}", type="revolute")
        place_element(joint, tuple(place.tolist()), UPRIGHT)
        SubElement(joint, "parent", link=before)
        SubElement(joint, "child", link=name)
        SubElement(joint, "axis", xyz=" ".join(map(str, piece.axis)))
        most, speed = draws.uniform(*LIMIT), draws.uniform(*SPEED)
        bounds = {"lower": f"{-most:.4f}", "upper": f"{most:.4f}"}
        SubElement(joint, "limit", bounds, velocity=f"{speed:.3f}", effort="0")
        robot.append(_link(name, way, radius))
        before, place = name, way
    SubElement(robot, "link", name="flange")
    end = SubElement(robot, "joint", name="flange", type="fixed")
    place_element(end, tuple(place.tolist()), _facing(facing))
    SubElement(end, "parent", link=before)
    SubElement(end, "child", link="flange")
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, ElementTree.tostring(robot, "unicode"), durable=False)
    repair = Repair(path, float(draws.uniform(*DENSITY)) * length**2)  # masses by volume, torques by the needed ones
    assert repair.robot is not None
    strength = draws.uniform(*STRENGTH)
    for limit in repair.robot.iter("limit"):
        limit.set("effort", f"{strength * float(limit.get('effort', '0')):.4g}")
    repair.write(path)


def _link(name: str, way: Array, radius: float) -> Element:
    """A link along its way, thinner if the way is short."""
    size = float(np.linalg.norm(way))
    axis = way / size
    side = np.eye(3)[np.abs(axis).argmin()]
    x = np.cross(side, axis) / np.linalg.norm(np.cross(side, axis))
    turn = quaternion_of(np.column_stack([x, np.cross(axis, x), axis]))
    a, b, c = (way / 2).tolist()
    shape = Capsule(radius, max(size - radius, 0.2 * radius), position=(a, b, c), orientation=turn)
    return link_element(name, [shape], 0.0, None, (0.62, 0.66, 0.72, 1.0))


def _facing(axis: tuple[int, int, int]) -> Quaternion:
    """The rotation of a frame whose z axis points along this one."""
    columns = {X: (Y, Z, X), Y: (Z, X, Y), Z: (X, Y, Z)}[axis]
    return quaternion_of(np.array(columns, float).T)
