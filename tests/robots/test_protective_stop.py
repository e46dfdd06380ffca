"""A protective stop: what the arm notices, and what it does to the episode, on both engines."""

from typing import Any

import numpy as np
import pytest
from support.rig import ENGINES, made, values

from karolos.core import Step
from karolos.environments.robot_task import RobotTask
from karolos.registry import load
from karolos.robots.protective_stop import Guard, ProtectiveStop
from karolos.simulation.geometry import Box
from karolos.specification.parts import Part


def guard(**limits: Any) -> Guard:
    return Guard(ProtectiveStop(**limits), effort=(10.0, 20.0), period=0.1)


def pressed_on_the_floor(engine: str, draws: dict[str, Part] | None = None, **stop: Any) -> tuple[RobotTask, Step]:
    """A Panda whose hand goes down, at most 40 steps, and its last step; the limits are in `stop`."""
    how = {"environment": {"engine": engine}, "arm": {"protective_stop": stop or None}}
    environment = made("reach", draws=draws, max_steps=100, **how)
    box = environment.robot.workspace
    environment.robot.workspace = Box((*box.low[:2], -0.1), box.high)  # lower than the hand can go
    step = environment.reset(0)
    for _ in range(40):
        step = environment.step(np.array([0.0, 0.0, -1.0], np.float32))
        if step.truncated or step.terminated:
            break
    return environment, step


def test_a_force_beyond_the_limit_stops_at_once_and_counts_once_while_it_lasts():
    watching = guard(force=100.0)
    for force in (0.0, 99.0, 101.0, 300.0, 0.0, 120.0):
        watching.watch({(3, 0): force}, (0.0, 0.0))
    assert (watching.stops, watching.stopped) == (2, True)
    watching.reset()
    assert (watching.stops, watching.stopped) == (0, False)


def test_a_torque_at_its_limit_stops_only_if_it_lasts():
    watching = guard(torque=0.9, seconds=0.3)
    for torque in (9.5, 9.5, 8.0, -9.5, -9.5):
        watching.watch({}, (torque, 0.0))
    assert not watching.stopped
    watching.watch({}, (-9.5, 0.0))
    assert watching.stopped


@pytest.mark.parametrize("engine", ENGINES)
def test_a_motor_that_friction_leaves_less_torque_stops_at_that(engine):
    environment, step = pressed_on_the_floor(engine, {"robot.joint_friction": values(0.3)}, force=None, seconds=0.1)
    assert step.truncated
    assert environment.robot.stops == 1


@pytest.mark.parametrize("engine", ENGINES)
def test_a_hand_that_presses_on_the_floor_ends_the_episode_without_success(engine):
    environment, step = pressed_on_the_floor(engine, force=150.0)
    assert (step.truncated, step.terminated, step.success) == (True, False, False)
    assert environment.robot.stops == 1
    with pytest.raises(RuntimeError, match="over"):
        environment.step(np.zeros(3, np.float32))
    environment.reset(1)
    assert environment.robot.stops == 0


@pytest.mark.parametrize("engine", ENGINES)
def test_a_stop_may_only_be_counted_or_be_off(engine):
    for stop, stops in (({"ends": False}, True), ({}, False)):
        environment, step = pressed_on_the_floor(engine, **stop)
        assert not step.truncated
        assert (environment.robot.stops > 0) == stops


def test_tasks_choose_whether_an_arm_stops_by_default():
    for task, on in (("reach", False), ("push", False), ("pick_place", False), ("throw", True)):
        assert load("tasks", task).protective_stop == on
