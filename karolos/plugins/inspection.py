"""Tables of facts about a robot, a gripper or a task, and a picture of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, field
from inspect import getdoc
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from ..core import Discrete, Layout
from ..core.parameters import RandomizedParameter
from ..core.seeding import SeedTree
from ..environments.robot_task import RobotTask
from ..errors import UsageError
from ..evaluation.testing import test_seeds
from ..registry import blaming, load, names
from ..robots.arm import Arm
from ..robots.proposal import doubts
from ..simulation.engines import Engine, make_world
from ..simulation.interface import Camera, ControlMode, Cup, Gripper, TaskNeeds
from .contracts.case import candidate, required
from .contracts.joined import CONTROLS, join

Facts = dict[str, Any]
"""One row: names of columns and JSON-able values."""


@dataclass(frozen=True)
class Inspection:
    """Tables of facts by heading, and a picture."""

    name: str
    about: str
    tables: dict[str, list[Facts]] = field(default_factory=dict)
    picture: NDArray[np.uint8] | None = None


def pair(
    robot: str, task: str, engine: Engine | None = None, *, steps: int | None = None, **robot_settings: Any
) -> RobotTask:
    """A robot with a task at their defaults, except the engine, the steps of an episode and settings of the robot.

    Raises UsageError if one is unknown, or if the task does not work with the robot.
    """
    length: dict[str, Any] = {} if steps is None else {"max_steps": steps}
    return join(candidate("robots", robot, engine, **robot_settings), candidate("tasks", task), **length)


@blaming()
def inspect_robot(name: str, *, size: tuple[int, int] | None = (960, 720)) -> Inspection:
    """Facts about a robot and its gripper. `size`: of the picture in pixels; None: no picture."""
    plugin = load("robots", name)
    if needed := required(plugin):
        hint = "`karolos robot check FILE` shows an arm from a file"
        raise UsageError(f"the robot {name} has no default for {', '.join(needed)}", hint=hint)
    own = "control" in plugin.Settings.model_fields
    modes = get_args(ControlMode) if issubclass(plugin, Arm) else CONTROLS if own else (None,)
    robots = {mode: _prepared(plugin, mode) for mode in modes}
    first = next(iter(robots.values()))
    limits, workspace = first.limits, first.workspace
    labels = map(limits.name, range(len(limits.lower)))
    joints = zip(labels, limits.lower, limits.upper, limits.velocity, limits.effort, strict=True)
    places = {"home": first.home, "workspace low": workspace.low, "workspace high": workspace.high}
    tables: dict[str, list[Facts]] = {
        "joints": [
            {"joint": place, **_named("name lower_rad upper_rad speed_rad_s torque_N_m", values)}
            for place, values in enumerate(joints, 1)
        ],
        "tool": [{"what": one, **_named("x_m y_m z_m", np.round(place, 6).tolist())} for one, place in places.items()],
    }
    if isinstance(first, Arm):
        for row, home in zip(tables["joints"], first.home_joints, strict=True):
            row["home_rad"] = home
        tables |= _arm(first)
    if (grip := first.gripper) is not None:
        tables["gripper"] = [_grip(grip)]
    if isinstance(first, Arm) and (found := doubts(first.model.description)):
        tables["doubts"] = [{"doubted": line} for line in found]
    for mode, robot in robots.items():
        suffix = f" ({mode})" if mode else ""
        tables[f"action{suffix}"] = _fields(robot.action)
        for row in tables[f"action{suffix}"] if isinstance(robot, Arm) else ():
            row["an action of 1, in 1/24 s"] = _meaning(robot, row["field"])
        tables[f"observation{suffix}"] = _fields(robot.observation)
    tables["measures"] = [asdict(one) for one in first.measures]
    tables["parameters"] = _parameters({f"robot.{key}": value for key, value in first.parameters.items()})
    tables["settings"] = _settings(plugin)
    return Inspection(name, getdoc(plugin) or "", tables, picture(name, None, size))


@blaming()
def inspect_gripper(name: str, *, size: tuple[int, int] | None = (960, 720)) -> Inspection:
    """Facts about a gripper and the arms that carry it. `size`: of the picture in pixels; None: no picture."""
    plugin = load("grippers", name)
    model = plugin.model
    arms, first = [], None
    for arm in names("robots"):
        own = getattr(load("robots", arm), "model", None)
        if own is None or getattr(own, "flange", None) is None:
            continue
        first = arm if first is None or own.gripper == name else first
        robot = _prepared(load("robots", arm), None, gripper=name)
        low, high = (" ".join(f"{x:.3f}" for x in end) for end in (robot.workspace.low, robot.workspace.high))
        left = None if own.payload is None else round(own.payload - model.mass, 2)
        arms.append({"arm": arm, "own": own.gripper == name, "payload_left_kg": left, "from_m": low, "to_m": high})
    tables: dict[str, list[Facts]] = {
        "gripper": [{**_grip(model.fingers.gripper if model.fingers else model.cup), "mass_kg": round(model.mass, 3)}],
        "tool": [{"what": "tool centre point", **_named("x_m y_m z_m", model.tool)}],
        "workspace": arms,
    }
    shown = picture(first, None, size, gripper=name) if first else None
    return Inspection(name, getdoc(plugin) or "", tables, shown)


def _arm(arm: Arm) -> dict[str, list[Facts]]:
    """Place of the gripper on an arm, and of its tool."""
    model, flange = arm.model, arm.model.flange
    frame = _named("x_m y_m z_m roll_rad pitch_rad yaw_rad", (*model.tool, *model.tool_rpy))
    carried: Facts = {"payload_kg": model.payload, "gripper": model.gripper, "tool_speed_m_s": model.tool_speed}
    if flange is not None:
        place = _named("x_m y_m z_m roll_rad pitch_rad yaw_rad", (*flange.position, *flange.rpy))
        carried = {"link": flange.link, **place, **carried}
    return {"tool frame in the last link": [frame], "flange": [carried]}


def _meaning(arm: Arm, field: str) -> str:
    """Effect of a number of 1 in an action, in a control step of 1/24 s."""
    settings, what = arm.settings, "set point" if arm.settings.control == "impedance" else "tool"
    return {
        "joint_changes": f"{' '.join(f'{step:.3f}' for step in arm.joint_step)} rad, one for each joint",
        "tool_position_change": f"the {what} {arm.tool_step:g} m along an axis",
        "tool_turn": f"the {what} {settings.turn_step:g} rad about an axis",
    }.get(field, "gripper open; -1: closed")


def _grip(grip: Gripper | Cup) -> Facts:
    """The numbers of fingers or of a cup."""
    if isinstance(grip, Cup):
        return _named("radius_m max_force_N pad_friction", (grip.radius, grip.max_force, grip.pad_friction))
    return _named("width_m force_N speed_m_s pad_friction", (grip.width, grip.force, grip.speed, grip.pad_friction))


def _named(columns: str, values: Iterable[Any]) -> Facts:
    return dict(zip(columns.split(), values, strict=True))


def _prepared(plugin: Any, mode: str | None, **settings: Any) -> Any:
    robot = plugin(plugin.Settings(**({"control": mode} if mode else {}), **settings))
    robot.prepare(TaskNeeds(gripper=robot.gripper is not None, period=1 / 24))
    return robot


@blaming()
def inspect_task(name: str, robot: str = "panda", *, size: tuple[int, int] | None = (960, 720)) -> Inspection:
    """Facts about a task with a robot. `size`: of the picture in pixels; None: no picture."""
    plugin = load("tasks", name)
    environment = pair(robot, name)
    signature, task = environment.signature, environment.task
    rule = type(signature.goal_rule).__name__, *map(float, signature.reward_range), signature.max_steps
    columns = "rule reward_low reward_high max_steps uses_gripper"
    tables: dict[str, list[Facts]] = {
        "goal rule": [_named(columns, (*rule, task.uses_gripper))],
        "achieved goal": _fields(signature.achieved_goal),
        "desired goal": _fields(signature.desired_goal),
        "observation": _fields(task.observation),
        "measures": [asdict(one) for one in signature.measures],
        "parameters": _parameters({f"task.{key}": value for key, value in task.parameters.items()}),
        "settings": _settings(plugin),
    }
    environment.close()
    return Inspection(name, getdoc(plugin) or "", tables, picture(robot, name, size))


def _fields(layout: Layout | Discrete) -> list[Facts]:
    if isinstance(layout, Discrete):
        return [{"field": label, "from": place, "size": 1, "unit": "1"} for place, label in enumerate(layout.labels)]
    return [
        {"field": part.name, "from": layout.slice(part.name).start, "size": part.size, "unit": part.unit}
        for part in layout.fields
    ]


def _parameters(declared: Mapping[str, RandomizedParameter]) -> list[Facts]:
    columns = ("nominal", "low", "high", "unit")
    return [
        {"parameter": name, **{key: getattr(one, key) for key in columns}, "what": one.description}
        for name, one in declared.items()
    ]


def _settings(plugin: Any) -> list[Facts]:
    return [
        {
            "setting": name,
            "default": None if part.is_required() else str(part.get_default(call_default_factory=True)),
            "what": part.description or "",
        }
        for name, part in plugin.Settings.model_fields.items()
    ]


def picture(robot: str, task: str | None, size: tuple[int, int] | None, **settings: Any) -> NDArray[np.uint8] | None:
    """A picture of the first test episode's start, or of the robot alone at home. `settings`: of the robot."""
    if size is None:
        return None
    width, height = size
    if task is None:
        alone = _prepared(load("robots", robot), None, **settings)
        with closing(make_world(RobotTask.Settings.model_validate({}).engine)) as world:
            alone.build(world)
            alone.reset(SeedTree(0).generator())
            return world.render(width, height, Camera(base=alone.base))
    with closing(pair(robot, task)) as environment:
        environment.reset(test_seeds(0, 1)[0])
        return environment.render(width, height)
