"""The settings of an arm."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, model_validator
from pydantic import Field as Setting
from pydantic_core import PydanticCustomError

from ..core import Settings
from ..core.settings import LATER
from ..errors import UsageError
from ..randomization.randomization import Drawn
from ..registry import find
from ..simulation.interface import ControlMode
from .protective_stop import ProtectiveStop


def _installed_gripper(name: str) -> str:
    try:
        return find("grippers", name).name
    except UsageError as error:
        raise PydanticCustomError("unknown_name", "{message}", {"message": error.what, "hint": error.hint}) from None


Stiffness = Annotated[float, Setting(gt=0, le=5000)]


class ArmSettings(Settings):
    """Settings of every arm.

    Whatever the steps, motors ask for no speed beyond the data sheet's. A joint that a contact drives faster is
    braked with the torque of its motor. The default of `tool_step` is a distance that every built-in arm covers in each
    direction in steady motion.
    """

    gripper: Annotated[str, AfterValidator(_installed_gripper)] | None = Setting(
        None, description="what is mounted at the flange: franka_hand, robotiq_2f85, vacuum, ...; null: the arm's own"
    )
    control: ControlMode | None = Setting(
        None,
        description="what the action changes: joint positions; the position of a tool that points down (cartesian); "
        "its whole pose (pose); that of a spring that moves the tool (impedance); null: as the task says",
    )
    joint_step: float = Setting(
        0.5, gt=0, le=0.5, description="largest change of a joint per control step in rad; its speed may allow less"
    )
    tool_step: float = Setting(
        0.017,
        gt=0,
        le=0.2,
        description="largest change of the tool position per control step and axis, m; joint speeds may allow less",
    )
    acceleration: Literal["sheet"] | None = Setting(
        "sheet",
        description="sheet: the largest accelerations that the maker publishes, where one does (panda); null: a joint "
        "changes its speed by its limit in 1/24 s at the most",
    )
    tool_speed: float | None = Setting(
        None,
        gt=0,
        description="largest speed of the tool centre point, m/s; null: the maker's (panda 1.7, ur5 1.5), or, "
        "where no maker publishes one (iiwa), what the joints allow",
    )
    joint_slots: int | None = Setting(
        None,
        ge=1,
        le=16,
        json_schema_extra=LATER,
        description="joint control, for one policy of many arms: observations and actions have places for so many "
        "joints, 0 where the arm has fewer; it is observed how each joint moves the tool, and at home none moves it by "
        "more than tool_step in a control step; null: the arm's own joints",
    )
    yaw: bool = Setting(False, description="whether a cartesian action also turns the gripper about the vertical")
    yaw_step: float = Setting(0.2, gt=0, le=0.5, description="largest turn of the gripper per control step by yaw, rad")
    turn_step: float = Setting(
        0.1, gt=0, le=0.5, description="largest turn of the tool per control step by pose and impedance control, rad"
    )
    frame: Literal["base", "tool"] = Setting(
        "base", description="the axes along and about which pose and impedance actions move the tool"
    )
    stiffness: Annotated[float, Drawn("N/m", 100.0, 2000.0)] = Setting(
        800.0, gt=0, le=5000, description="of the spring of impedance control, N/m"
    )
    turn_stiffness: Annotated[float, Drawn("N m/rad", 10.0, 150.0)] = Setting(
        40.0, gt=0, le=300, description="of the same spring against turning, N m/rad"
    )
    damping_ratio: Annotated[float, Drawn("1", 0.5, 2.0)] = Setting(
        0.7, gt=0, le=5, description="of that spring; 1: just as much as keeps the tool from swinging"
    )
    error_limit: float = Setting(
        0.02, gt=0, le=0.2, description="largest distance of the tool from its set point that the spring pulls for, m"
    )
    turn_error_limit: float = Setting(0.2, gt=0, le=1, description="the same of the rotation, rad")
    stiffness_range: tuple[Stiffness, Stiffness] | None = Setting(
        None, description="a further number of an impedance action chooses the stiffness in this range, N/m; null: none"
    )
    reset_noise: float = Setting(
        0.02, ge=0, le=0.2, description="largest deviation of a joint from the home pose at a reset, rad"
    )
    observe: tuple[Literal["rotation", "wrench", "torques"], ...] = Setting(
        (),
        description="what is observed besides: the tool's rotation (two columns of its matrix), the wrench at the "
        "wrist (in the tool's frame, N and N m), the torques of the joints (N m)",
    )
    wrench_filter: float = Setting(0.02, ge=0, le=1, description="time constant of the wrench's low-pass, s")
    base: Literal["origin", "centred"] = Setting(
        "origin",
        description="what is at the origin of the world: the robot's base, or (centred) the middle of its workspace",
    )
    gripper_delay: Annotated[float, Drawn("s", 0.0, 0.1)] = Setting(
        0.0, ge=0, le=0.5, description="seconds after which the gripper follows its command, rounded to a physics step"
    )
    protective_stop: ProtectiveStop | Literal["task"] | None = Setting(
        "task",
        description="limits beyond which the arm stops, which ends the episode without success; task: as the task says "
        "(throw, insert, reach_pose and tasks that do not say: the default limits; the others: off); null: off",
    )
    timed_release: bool = Setting(
        False,
        description="whether a gripper that starts to open does so later in the control step the less it is told to "
        "open; false: at the beginning of the step",
    )
    finger_opening: float = Setting(
        0.0,
        ge=0,
        le=1,
        description="how far a gripper that the task does not use stands open, up to 1; 0: closed, in slide half open",
    )

    @model_validator(mode="after")
    def _range_rises(self) -> Self:
        if self.stiffness_range is not None and not self.stiffness_range[0] < self.stiffness_range[1]:
            low, high = self.stiffness_range
            raise ValueError(f"stiffness_range ends ({high:g}) not above where it begins ({low:g})")
        return self
