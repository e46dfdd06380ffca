"""KUKA LBR iiwa 14 R820 with a Robotiq 2F-85."""

from __future__ import annotations

from itertools import product
from math import pi
from pathlib import Path

from ..simulation.interface import Box
from .arm import Arm
from .model import FINGERS, ArmModel, Flange


class Iiwa(Arm):
    """Seven joints, reach .82 m, payload 14 kg, with a two-finger gripper.

    Sources: KUKA's data sheet, iiwa_stack, iiwa_ros; see urdf/iiwa.urdf. KUKA publishes the speeds of the joints
    (specification of the LBR iiwa, axis data), but neither their accelerations nor a speed of the tool.
    """

    model = ArmModel(
        urdf=Path(__file__).parent / "urdf" / "iiwa.urdf",
        home=(0.0, 0.5358, 0.0, -1.7364, 0.0, 0.8693, 0.0),  # tool at .52 0 .2
        workspace=Box((0.42, -0.25, 0.02), (0.73, 0.25, 0.34)),  # lower, the pads (half .01875 m high) meet the floor
        dexterous=Box((0.54, -0.15, 0.04), (0.7, 0.15, 0.3)),
        tool_rpy=(0.0, 0.0, pi),
        flange=Flange("link7", (0.0, 0.0, 0.045), (0.0, 0.0, 0.0)),
        gripper="robotiq_2f85",
        turn_with={"franka_hand": 0.8},
        payload=14.0,
        self_collisions=tuple(product(("link5", "link6", "link7", FINGERS), ("link0", "link1", "link2"))),
    )
