"""A small arm of six joints: the numbers of an `ArmModel`, and a URDF beside this file."""

from __future__ import annotations

from math import pi
from pathlib import Path

from karolos.robots.arm import Arm, ArmModel, ArmSettings
from karolos.simulation.interface import Box, Fingers, Gripper

TRAVEL = 0.035
"""Of each finger, in m; as the limits of the finger joints in the URDF."""


class DeskArm(Arm):
    """Six joints, reach .58 m, a gripper of two fingers that opens 7 cm. Made up; its limits stand in the URDF."""

    class Settings(ArmSettings):
        """As every arm's."""

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
