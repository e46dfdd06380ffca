"""The promises of a plugin, by its kind, and functions that check them."""

from __future__ import annotations

import traceback
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

from ...environments.robot_task import RobotTask
from ...errors import KarolosError, UsageError, alternatives
from ...registry import blaming, names, singular
from ...robots.arm import Arm
from ...simulation.engines import ENGINES
from ...simulation.interface import Cup, Task
from . import agents, buffers, distributions, environments, pairs, robots, tasks
from .case import Candidate, Case, candidate, required
from .joined import TURNING, controls, goes_with, refusal, under

KINDS = ("robots", "grippers", "tasks", "agents", "buffers", "environments", "distributions")
"""Kinds with contracts. Orchestrators are tested only in karolos."""
USUAL_ROBOT = "panda"
"""The robot with which a task's own promises are checked."""


@blaming()
def cases(one: Candidate, *, alone: bool = False) -> list[Case]:
    """Every promise of a plugin; `alone`: without those that need each installed robot, task or arm, too.

    Raises:
        UsageError: a setting is missing, the kind has no contracts, or it is the environment robot_task, which is
            checked as a robot with a task.
        PluginError: a third party's plugin fails before its promises can be listed.
    """
    if one.kind == "robots":
        return _of_robot(one) + ([] if alone else [case for task in _all("tasks") for case in of_pair(one, task)])
    if one.kind == "tasks":
        usual = candidate("robots", USUAL_ROBOT, one.engine)
        found = environments.BEGINS.cases(usual, one) + tasks.PROMISES.cases(usual, one)
        return found + ([] if alone else [case for robot in _all("robots") for case in of_pair(robot, one)])
    one.settled()
    if one.kind == "grippers":
        return _of_gripper(one, alone=alone)
    if one.kind == "agents":
        return agents.PROMISES.cases(one)
    if one.kind in ("buffers", "distributions"):
        replay = buffers.ON_POLICY if getattr(one.plugin, "on_policy", False) else buffers.REPLAY
        return (replay if one.kind == "buffers" else distributions.PROMISES).cases(one)
    if one.kind == "environments" and one.name != "robot_task":
        return environments.BEGINS.cases(one) + environments.REPEATS.cases(one) + environments.PROMISES.cases(one)
    hint = "check a robot or a task" if one.kind == "environments" else alternatives(one.kind, KINDS)
    raise UsageError(f"there are no contracts for {singular(one.kind)} {one.name}", hint=hint)


def of_pair(robot: Candidate, task: Candidate) -> list[Case]:
    """Promises of a robot with a task: as an environment under each control mode that fits, and as a pair.

    A task that refuses the robot has to give a reason; nothing else is checked then.
    """
    if task.plugin.uses_gripper and robot.plugin(robot.settled()).gripper is None:
        return []
    if refusal(robot, task) is not None:
        return pairs.REFUSED.cases(robot, task)
    groups = [pairs.PROMISES] if task.plugin.expert is Task.expert else [pairs.EXPERT, pairs.PROMISES]
    if task.name == "reach":
        groups += [pairs.IN_REACH, pairs.ARM_IN_REACH] if issubclass(robot.plugin, Arm) else [pairs.IN_REACH]
    modes = [mode for mode in controls(robot) if goes_with(task, mode.settings.get("control"))]
    if task.plugin.control in TURNING and issubclass(robot.plugin, Arm):
        modes.append(under(robot, task.plugin.control))
    both = environments.REPEATS, environments.PROMISES
    found = [case for mode in modes for group in both for case in group.cases(mode, task)]
    return found + [case for group in groups for case in group.cases(robot, task)]


def results(found: Iterable[Case]) -> Iterator[tuple[Case, str | None]]:
    """Each case with its error in one line; None if the promise is kept. Ends after a broken basic promise."""
    for case in found:
        problem = _problem(case)
        yield case, problem
        if case.group.basic and problem is not None:
            return


def _problem(case: Case) -> str | None:
    try:
        case()
    except AssertionError as error:
        return str(error)
    except KarolosError as error:
        return " ".join(str(error).splitlines())
    except Exception as error:  # a plugin may raise anything; the traceback shows the place
        traceback.print_exception(error)
        return f"{type(error).__name__}: {' '.join(str(error).splitlines())}"
    return None


def check(kind: str, name: str, **settings: Any) -> None:
    """Check every promise of an installed plugin. A robot and a task take about a minute.

    Args:
        kind: robots, grippers, tasks, agents, buffers, environments or distributions.
        name: its name in specs.
        settings: those that differ from the defaults.

    Raises:
        AssertionError: promises are broken; one line for each different problem.
        UsageError: the plugin is unknown, or its kind has no contracts.
        PluginError: the plugin does not import, or lacks a part of its kind's interface.
    """
    broken: dict[str, str] = {}
    for case, problem in results(cases(candidate(kind, name, **settings))):
        if problem is not None and problem not in broken.values():
            broken[str(case)] = problem
    if broken:
        raise AssertionError("\n".join(f"{case}: {problem}" for case, problem in broken.items()))


def _of_robot(one: Candidate) -> list[Case]:
    modes, is_arm = controls(one), issubclass(one.plugin, Arm)
    springs = "impedance" in ENGINES[one.engine or RobotTask.Settings.model_fields["engine"].default].abilities
    turned = [under(one, control) for control in TURNING if is_arm and (control != "impedance" or springs)]
    modes += turned
    groups = [robots.ANY_ROBOT, robots.ARM] if is_arm else [robots.ANY_ROBOT]
    found = [case for mode in modes for case in robots.BEGINS.cases(mode)]
    found += [case for group in groups for mode in modes for case in group.cases(mode)]
    if is_arm:
        joint, cartesian = under(one, "joint"), under(one, "cartesian")
        model = one.plugin(one.settled()).model
        found += robots.JOINT_CONTROL.cases(joint) + robots.LIMITS.cases(joint)
        found += robots.SHEET.cases(joint) if model.accelerations is not None else []
        found += robots.CARTESIAN_CONTROL.cases(cartesian)
        found += _of_grip(cartesian)
        for mode in turned:
            found += robots.TURNED.cases(mode) if model.dexterous is not None else []
            found += robots.IMPEDANCE_CONTROL.cases(mode) if mode.settings["control"] == "impedance" else []
    return found


def _of_gripper(one: Candidate, *, alone: bool) -> list[Case]:
    """Promises of a gripper on each installed arm with a flange."""
    found = []
    for arm in _all("robots"):
        model = arm.plugin.model if issubclass(arm.plugin, Arm) else None
        if model is None or model.flange is None or (alone and model.gripper == one.name):
            continue
        robot = under(replace(arm, settings={"gripper": one.name}, engine=one.engine), "cartesian")
        for group in (robots.BEGINS, robots.ANY_ROBOT):
            found += group.cases(robot)
        found += _of_grip(robot)
        if robot.plugin(robot.settled()).dexterous is not None:
            found += robots.TURNED.cases(under(robot, "pose"))
    return found


def _of_grip(robot: Candidate) -> list[Case]:
    """Promises of the robot's gripper."""
    gripper = robot.plugin(robot.settled()).gripper
    if gripper is None:
        return []
    return robots.GRIPPER.cases(robot) + (robots.CUP if isinstance(gripper, Cup) else robots.FINGERS).cases(robot)


def _all(kind: str) -> list[Candidate]:
    """All installed plugins of a kind that work at their defaults."""
    return [one for name in names(kind) if not required((one := candidate(kind, name)).plugin)]
