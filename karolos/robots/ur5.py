"""Universal Robots UR5 with a Robotiq 2F-85."""

from __future__ import annotations

from itertools import product
from math import pi
from pathlib import Path

from ..simulation.interface import Box
from .arm import Arm
from .model import FINGERS, ArmModel, Flange


class UR5(Arm):
    """Six joints, reach .85 m, payload 5 kg, with a two-finger gripper.

    Sources: Universal Robots' data sheet and Denavit-Hartenberg parameters, ur_description; see urdf/ur5.urdf.
    Universal Robots publishes torques, but no accelerations (ur_description, joint_limits.yaml). The safety
    configuration limits the speed of the tool ("General limits" in the manual of UR5/CB3); typical is 1 m/s.
    """

    model = ArmModel(
        urdf=Path(__file__).parent / "urdf" / "ur5.urdf",
        home=(-0.2294, -1.5893, 1.8333, -1.8149, -1.5708, -1.8002),  # tool at .48 0 .2
        workspace=Box((0.25, -0.25, 0.02), (0.65, 0.25, 0.4)),  # lower, the pads (half .01875 m high) meet the floor
        dexterous=Box((0.37, -0.15, 0.04), (0.61, 0.15, 0.34)),
        tool_rpy=(-pi / 2, 0.0, 0.0),
        flange=Flange("wrist_3", (0.0, 0.0823, 0.0), (-pi / 2, 0.0, 0.0)),
        gripper="robotiq_2f85",  # the broader franka_hand touches the forearm when it turns
        payload=5.0,
        tool_speed=1.5,  # default of the safety configuration, "General limits"
        self_collisions=tuple(product(("wrist_1", "wrist_2", "wrist_3", FINGERS), ("base", "shoulder", "upper_arm")))
        + tuple((distal, "forearm") for distal in ("base", "shoulder", "wrist_3", FINGERS)),
    )
