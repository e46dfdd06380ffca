"""Franka Emika Panda with its parallel gripper."""

from __future__ import annotations

from itertools import product
from math import pi
from pathlib import Path

from ..simulation.interface import Box, Fingers, Gripper
from .arm import Arm, ArmModel


class Panda(Arm):
    """Seven joints, reach .855 m, payload 3 kg, a gripper of two fingers that opens 8 cm.

    Sources: Franka Emika's data sheet and interface documentation, Gaz et al. 2019; see urdf/panda.urdf.
    """

    model = ArmModel(
        urdf=Path(__file__).parent / "urdf" / "panda.urdf",
        home=(0.0, 0.41, 0.0, -1.85, 0.0, 2.26, pi / 4),  # tool at .638 0 .199, as in panda-gym
        workspace=Box((0.3, -0.25, 0.015), (0.7, 0.25, 0.4)),
        dexterous=Box((0.42, -0.15, 0.03), (0.66, 0.15, 0.33)),
        tool=(0.0, 0.0, 0.2104),  # flange .107, tool centre point .1034 beyond it
        tool_rpy=(0.0, 0.0, -pi / 4),
        fingers=Fingers(
            joints=("finger_joint1", "finger_joint2"),
            links=("finger1", "finger2"),
            travel=0.04,
            open_at_zero=False,
            gripper=Gripper(width=0.08, force=20.0, speed=0.05, pad_friction=1.0),
        ),
        accelerations=(15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0),  # interface documentation, joint limits
        tool_speed=1.7,  # interface documentation, Cartesian limits, translation
        # what the joint limits leave possible
        self_collisions=(
            ("link7", "link5"),
            *product(("link5", "link6", "link7", "finger1", "finger2"), ("link0", "link1", "link2")),
        ),
    )
