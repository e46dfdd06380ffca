"""Grippers that a spec mounts on an arm: two fingers that slide towards each other, or a suction cup."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from ... import core
from ...simulation import urdf
from ...simulation.geometry import Vector
from ...simulation.interface import Cup, Fingers


@dataclass(frozen=True)
class GripperModel:
    """The numbers of one gripper. The frame of its URDF's base lies in the arm's flange, with z away from the arm.

    Masses, and the limits of the fingers, come from its URDF. Every joint that moves there is one of the fingers.
    """

    urdf: Path
    tool: Vector
    """Tool centre point in the frame of the base, in m. The tool approaches along z."""
    fingers: Fingers | None = None
    cup: Cup | None = None
    """Suction cup that replaces fingers."""
    least_height: float = 0.02
    """Smallest height of the tool centre point above the floor while the tool points down, in m. An arm that comes with
    the gripper may have another value."""
    variants: Mapping[str, Path] = field(default_factory=dict)
    """URDFs that stand for this one on some arms, by the name of the arm's URDF, such as ur5."""

    @property
    def mass(self) -> float:
        """Mass in kg."""
        robot = urdf.load(self.urdf, slides=self.fingers.joints if self.fingers else ()).robot
        return sum(float(one.get("value", "0")) for one in robot.iterfind("link/inertial/mass"))


class ParallelGripper:
    """A gripper; a subclass sets `model`."""

    class Settings(core.Settings):
        """No settings: the spec of an arm names its gripper."""

    model: ClassVar[GripperModel]
