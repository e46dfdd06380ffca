"""Franka Emika Panda with its parallel gripper."""

from __future__ import annotations

from itertools import product
from math import pi
from pathlib import Path

from ..simulation.interface import Box
from .arm import Arm
from .model import FINGERS, ArmModel, Flange


class Panda(Arm):
    """Seven joints, reach .855 m, payload 3 kg with the gripper; its own hand has two fingers.

    Sources: Franka Emika's data sheet and interface documentation, Gaz et al. 2019; see urdf/panda.urdf.
    """

    model = ArmModel(
        urdf=Path(__file__).parent / "urdf" / "panda.urdf",
        home=(0.0, 0.41, 0.0, -1.85, 0.0, 2.26, pi / 4),  # tool at .638 0 .199, as in panda-gym
        workspace=Box((0.3, -0.25, 0.015), (0.7, 0.25, 0.4)),
        dexterous=Box((0.42, -0.15, 0.03), (0.66, 0.15, 0.33)),
        flange=Flange("link7", (0.0, 0.0, 0.107), (0.0, 0.0, -pi / 4)),
        tool_rpy=(0.0, 0.0, -pi / 4),
        gripper="franka_hand",
        turn_with={"robotiq_2f85": 0.8},
        payload=3.0,
        accelerations=(15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0),  # interface documentation, joint limits
        tool_speed=1.7,  # interface documentation, Cartesian limits, translation
        # possible within the joint limits
        self_collisions=(
            ("link7", "link5"),
            *product(("link5", "link6", "link7", FINGERS), ("link0", "link1", "link2")),
        ),
    )
