"""A small arm of six joints: an `ArmModel` and the URDF beside this file."""

from __future__ import annotations

from math import pi
from pathlib import Path

from karolos.robots.arm import Arm, ArmModel, ArmSettings
from karolos.simulation.interface import Box, Fingers, Gripper

TRAVEL = 0.035
"""Travel of each finger in m: the limit of the finger joints in the URDF."""


class DeskArm(Arm):
    """Six joints, reach .58 m, a gripper of two fingers that opens 7 cm. Invented; the URDF holds its limits."""

    class Settings(ArmSettings):
        """Those of every arm."""

    model = ArmModel(
        urdf=Path(__file__).parent / "desk_arm.urdf",
        home=(0.0, 0.4128, 1.7015, 0.0, pi - 0.4128 - 1.7015, 0.0),  # tool at .36 0 .2, pointing down
        workspace=Box((0.26, -0.2, 0.02), (0.44, 0.2, 0.28)),
        tool=(0.0, 0.0, 0.09),
        tool_rpy=(0.0, 0.0, 0.0),
        fingers=Fingers(
            joints=("finger1_slide", "finger2_slide"),
            links=("finger1", "finger2"),
            travel=TRAVEL,
            open_at_zero=False,
            gripper=Gripper(width=2 * TRAVEL, force=40.0, speed=0.08, pad_friction=1.0),
        ),
    )
