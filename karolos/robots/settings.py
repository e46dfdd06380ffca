"""The settings of an arm."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, model_validator
from pydantic import Field as Setting
from pydantic_core import PydanticCustomError

from ..core import Settings
from ..core.parameters import Drawn
from ..core.settings import LATER
from ..errors import UsageError
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

    Motors never ask for more speed than the data sheet allows, with any step. If a contact drives a joint faster, its
    motor brakes it. The default of `tool_step` is a distance that every built-in arm covers in each direction in steady
    motion.
    """

    gripper: Annotated[str, AfterValidator(_installed_gripper)] | None = Setting(
        None, description="gripper at the flange: franka_hand, robotiq_2f85, vacuum, ...; null: the arm's own"
    )
    control: ControlMode | None = Setting(
        None,
        description="what an action changes. joint: joint positions; cartesian: position of a tool that points down; "
        "pose: pose of the tool; impedance: pose of a spring that moves the tool; null: as the task says",
    )
    joint_step: float = Setting(
        0.5, gt=0, le=0.5, description="largest change of a joint per control step, rad; its speed may allow less"
    )
    tool_step: float = Setting(
        0.017,
        gt=0,
        le=0.2,
        description="largest change of the tool position per control step and axis, m; joint speeds may allow less",
    )
    acceleration: Literal["sheet"] | None = Setting(
        "sheet",
        description="accelerations of the joints; sheet: the largest ones of the data sheet, if it has any (panda); "
        "null: a joint needs at least 1/24 s to reach its speed limit",
    )
    tool_speed: float | None = Setting(
        None,
        gt=0,
        description="largest speed of the tool centre point, m/s; null: as the data sheet says (panda 1.7, ur5 1.5); "
        "without such a value (iiwa) only the joints limit it",
    )
    joint_slots: int | None = Setting(
        None,
        ge=1,
        le=16,
        json_schema_extra=LATER,
        description="joint control, for one policy of many arms: number of joints in observations and actions, "
        "with zeros if the arm has fewer. Observations say how each joint moves the tool. At home no joint moves it by "
        "more than tool_step in a control step. null: the arm's own joints",
    )
    yaw: bool = Setting(False, description="whether a cartesian action also turns the gripper about the vertical")
    yaw_step: float = Setting(0.2, gt=0, le=0.5, description="largest turn of the gripper per control step, rad")
    turn_step: float = Setting(
        0.1, gt=0, le=0.5, description="largest turn of the tool per control step in pose and impedance control, rad"
    )
    frame: Literal["base", "tool"] = Setting(
        "base", description="axes along and about which actions move the tool in pose and impedance control"
    )
    stiffness: Annotated[float, Drawn("N/m", 100.0, 2000.0)] = Setting(
        800.0, gt=0, le=5000, description="stiffness of the spring in impedance control, N/m"
    )
    turn_stiffness: Annotated[float, Drawn("N m/rad", 10.0, 150.0)] = Setting(
        40.0, gt=0, le=300, description="rotational stiffness of the same spring, N m/rad"
    )
    damping_ratio: Annotated[float, Drawn("1", 0.5, 2.0)] = Setting(
        0.7, gt=0, le=5, description="damping ratio of the spring; 1: critical damping, the tool does not swing"
    )
    error_limit: float = Setting(
        0.02, gt=0, le=0.2, description="largest distance between tool and set point that the spring uses, m"
    )
    turn_error_limit: float = Setting(0.2, gt=0, le=1, description="the same for the rotation, rad")
    stiffness_range: tuple[Stiffness, Stiffness] | None = Setting(
        None, description="range of the stiffness that one more number of the action chooses, N/m; null: fixed"
    )
    reset_noise: float = Setting(
        0.02, ge=0, le=0.2, description="largest deviation of a joint from the home pose at a reset, rad"
    )
    observe: tuple[Literal["rotation", "wrench", "torques"], ...] = Setting(
        (),
        description="additional observations: the tool's rotation (two columns of its matrix), the wrench at the "
        "wrist (in the tool's frame, N and N m), the torques of the joints (N m)",
    )
    wrench_filter: float = Setting(0.02, ge=0, le=1, description="time constant of the wrench's low-pass, s")
    base: Literal["origin", "centred"] = Setting(
        "origin",
        description="origin: the robot's base is at the origin of the world; centred: the middle of its workspace",
    )
    gripper_delay: Annotated[float, Drawn("s", 0.0, 0.1)] = Setting(
        0.0, ge=0, le=0.5, description="delay of the gripper after its command in seconds, rounded to a physics step"
    )
    protective_stop: ProtectiveStop | Literal["task"] | None = Setting(
        "task",
        description="limits beyond which the arm stops and the episode ends without success; null: off; task: as the "
        "task says (the default limits in throw, insert, reach_pose and tasks that do not say, else off)",
    )
    timed_release: bool = Setting(
        False,
        description="whether the opening command sets the moment in the control step at which the gripper opens; a "
        "smaller command opens later; false: it opens at the beginning of the step",
    )
    finger_opening: float = Setting(
        0.0,
        ge=0,
        le=1,
        description="opening of a gripper that the task does not use; 1: open; 0: closed (in slide: half open)",
    )

    @model_validator(mode="after")
    def _range_rises(self) -> Self:
        if self.stiffness_range is not None and not self.stiffness_range[0] < self.stiffness_range[1]:
            low, high = self.stiffness_range
            raise ValueError(f"stiffness_range must be [smallest, largest], not [{low:g}, {high:g}]")
        return self
