"""The data that make an arm: its model, the settings and the parameters that all arms share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import Field as Setting

from ..core import Settings
from ..randomization.parameter import Parameter
from ..simulation.body import Vector
from ..simulation.interface import Box, Gripper

PARAMETERS: Mapping[str, Parameter] = {
    "joint_damping": Parameter("N m s/rad", 0.0, 0.0, 20.0, "viscous friction of every joint"),
    "joint_friction": Parameter("N m", 0.0, 0.0, 10.0, "dry friction: what every motor has less of its torque"),
    "link_mass": Parameter("1", 1.0, 0.2, 5.0, "factor on the masses and inertias of all links"),
    "motor_gain": Parameter("1", 1.0, 0.1, 4.0, "factor on the stiffness of the position control"),
    "observation_noise": Parameter("1", 0.0, 0.0, 0.2, "standard deviation of what is added, in SI units"),
    "action_delay": Parameter("control steps", 0.0, 0.0, 5.0, "how late actions take effect; rounded"),
}


def pad_friction(nominal: float) -> Parameter:
    return Parameter("1", nominal, 0.0, 5.0, "lateral friction coefficient of the gripper's pads")


class ArmSettings(Settings):
    """What every arm can be told. Whatever the steps, motors do not exceed the speeds of the data sheet."""

    control: Literal["joint", "cartesian"] | None = Setting(
        None, description="what the action changes; null: cartesian, or joint where a task turns the gripper (throw)"
    )
    joint_step: float = Setting(
        0.5, gt=0, le=0.5, description="largest change of a joint per control step in rad; its speed may allow less"
    )
    tool_step: float = Setting(0.05, gt=0, le=0.2, description="largest way of the tool per control step and axis, m")
    yaw: bool = Setting(False, description="whether a cartesian action also turns the gripper about the vertical")
    yaw_step: float = Setting(0.2, gt=0, le=0.5, description="largest turn of the gripper per control step, rad")
    reset_noise: float = Setting(
        0.02, ge=0, le=0.2, description="largest deviation of a joint from the home pose at a reset, rad"
    )


@dataclass(frozen=True)
class Fingers:
    """Two prismatic joints of the URDF that move as one."""

    joints: tuple[str, str]
    links: tuple[str, str]
    travel: float
    """Of each finger, in m."""
    open_at_zero: bool
    """Whether joint position 0 means open, else closed."""
    facts: Gripper

    def position(self, opening: float) -> float:
        """Joint position in m for an opening in [0, 1]."""
        return self.travel * (1 - opening if self.open_at_zero else opening)

    def opening(self, position: float) -> float:
        share = position / self.travel
        return 1 - share if self.open_at_zero else share


@dataclass(frozen=True)
class ArmModel:
    """The numbers of one arm; limits, efforts and speeds of the joints stand in its URDF.

    The revolute joints of the URDF, in order, are the arm. Its base stands on the floor at the world's origin.
    """

    urdf: Path
    home: tuple[float, ...]
    """Joint positions in rad with the tool pointing down."""
    workspace: Box
    """Where the tool can be while pointing down, in m."""
    tool: Vector
    """Tool centre point in the frame of the last link, in m."""
    tool_rpy: Vector
    """Tool frame in the frame of the last link, rad; its z axis is the direction of approach."""
    fingers: Fingers | None = None
    self_collisions: tuple[tuple[str, str], ...] = ()
    """Pairs of links that stop each other; all other pairs of the arm pass through."""
