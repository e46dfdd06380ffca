"""Robotiq 2F-85, the gripper of the UR5 and the iiwa."""

from __future__ import annotations

from pathlib import Path

from ...simulation.interface import Fingers, Gripper
from .parallel import GripperModel, ParallelGripper

URDF = Path(__file__).parent / "urdf"


class Robotiq2F85(ParallelGripper):
    """Two fingers with an opening of 8.5 cm, .9 kg. Source: Robotiq's data sheet; see urdf/robotiq_2f85.urdf."""

    model = GripperModel(
        urdf=URDF / "robotiq_2f85.urdf",
        tool=(0.0, 0.0, 0.137),
        fingers=Fingers(
            joints=("finger_joint1", "finger_joint2"),
            links=("finger1", "finger2"),
            travel=0.0425,
            open_at_zero=True,
            # force: of 20 to 235 N; speed: of up to .15 m/s of both pads together; pads: rubber
            gripper=Gripper(width=0.085, force=30.0, speed=0.075, pad_friction=1.0),
        ),
        least_height=0.02,  # the pads are half .01875 m high
        variants={"ur5": URDF / "robotiq_2f85_ur5.urdf"},
    )
