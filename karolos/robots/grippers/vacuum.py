"""A suction cup on a short tube."""

from __future__ import annotations

from math import pi
from pathlib import Path
from typing import ClassVar

from ... import core
from ...simulation.interface import Cup
from .parallel import GripperModel

RADIUS = 0.015
"""Radius of the lip, in m."""
PRESSURE = 60e3
"""Pa below the air pressure: a vacuum of 60 %, for which makers state holding forces."""


class VacuumCup:
    """A cup of 30 mm, .22 kg, that holds up to 42 N, on arms simulated by MuJoCo.

    Source: Schmalz, glossary, "Holding force": pressure times area, without a safety factor. See urdf/vacuum.urdf.
    """

    class Settings(core.Settings):
        """No settings: the spec of an arm names its gripper."""

    model: ClassVar[GripperModel] = GripperModel(
        urdf=Path(__file__).parent / "urdf" / "vacuum.urdf",
        tool=(0.0, 0.0, 0.08),
        cup=Cup(radius=RADIUS, max_force=round(PRESSURE * pi * RADIUS**2, 1), pad_friction=1.0),
        least_height=0.01,
    )
