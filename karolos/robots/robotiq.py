"""Robotiq 2F-85, the gripper of the UR5 and the iiwa."""

from __future__ import annotations

from ..simulation.interface import Fingers, Gripper

ROBOTIQ_2F_85 = Fingers(
    joints=("finger_joint1", "finger_joint2"),
    links=("finger1", "finger2"),
    travel=0.0425,
    open_at_zero=True,
    gripper=Gripper(width=0.085, force=30.0, speed=0.075, pad_friction=1.0),  # force: of 20 to 235 N; pads: rubber
)
"""Stroke 85 mm, closing speed up to .15 m/s of both pads together. Source: Robotiq's data sheet."""
