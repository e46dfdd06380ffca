"""The hand of Franka Emika's arms."""

from __future__ import annotations

from pathlib import Path

from ...simulation.interface import Fingers, Gripper
from .parallel import GripperModel, ParallelGripper


class FrankaHand(ParallelGripper):
    """Two fingers with an opening of 8 cm, .76 kg. Source: Franka Emika's data sheet; see urdf/franka_hand.urdf."""

    model = GripperModel(
        urdf=Path(__file__).parent / "urdf" / "franka_hand.urdf",
        tool=(0.0, 0.0, 0.1034),
        fingers=Fingers(
            joints=("finger_joint1", "finger_joint2"),
            links=("finger1", "finger2"),
            travel=0.04,
            open_at_zero=False,
            gripper=Gripper(width=0.08, force=20.0, speed=0.05, pad_friction=1.0),
        ),
        least_height=0.015,
    )
