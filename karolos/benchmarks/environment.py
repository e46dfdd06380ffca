"""How fast an environment steps, beside the bare physics of the same episodes.

The peer replays the motor targets of the very same episodes and counts the time of the physics steps alone: an arm
that moves costs more than one at rest, so a loop that lets it come to rest would be no fair peer.
All cases are measured in turn, many times over; the figures are medians, in processor time of this thread, because a
machine is never alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from statistics import median
from time import perf_counter, thread_time
from typing import Any

import numpy as np

from ..core import Array
from ..environments.robot_task import RobotTask
from ..randomization.distribution import Distribution
from ..randomization.normal import Normal
from ..registry import load
from ..simulation.body import Body
from .row import Row

PEER = "bare physics loop"


@dataclass
class _Case:
    """One environment and what has been measured of it: seconds per step or reset."""

    control: str
    environment: RobotTask
    randomized: RobotTask
    """The same with every parameter drawn at each reset, always as its nominal value: the same physics."""
    actions: Array
    stepping: list[float] = field(default_factory=list)
    physics: list[float] = field(default_factory=list)
    resetting: list[float] = field(default_factory=list)
    plain: list[float] = field(default_factory=list)
    """Seconds of an episode from reset to reset."""
    drawn: list[float] = field(default_factory=list)


def measure(
    robot: str = "panda", task: str = "reach", *, controls: Sequence[str] = ("joint", "cartesian"), seconds: float = 10
) -> list[Row]:
    """Steps per second, and resets, of one robot with one task under random actions, on one core.

    Args:
        seconds: time for all measurements together.

    Raises:
        UsageError: no such robot or task.
    """
    cases = [_case(robot, task, control) for control in controls]
    end = perf_counter() + seconds
    seed = 0
    while perf_counter() < end or seed < 3:
        for case in cases:
            _repeat(case, seed)
        seed += 1
    rows = []
    for case in cases:
        case.environment.close()
        case.randomized.close()
        name = f"{robot} {task} {case.control}"
        rows.append(Row("environment", name, 1 / median(case.stepping), "steps/s", PEER, 1 / median(case.physics)))
        rows.append(Row("environment", f"{name} reset", 1e3 * median(case.resetting), "ms"))
        with_it, without = (1 / median(times) for times in (case.drawn, case.plain))
        rows.append(Row("environment", f"{name} randomized episode", with_it, "episodes/s", "not randomized", without))
    return rows


def _case(robot: str, task: str, control: str) -> _Case:
    environment = _joined(robot, task, control, {})
    declared = {
        **{f"robot.{name}": parameter for name, parameter in environment.robot.parameters.items()},
        **{f"task.{name}": parameter for name, parameter in environment.task.parameters.items()},
    }
    randomized = _joined(
        robot,
        task,
        control,
        {name: Normal(Normal.Settings(mean=parameter.nominal, std=0.0)) for name, parameter in declared.items()},
    )
    generator = np.random.Generator(np.random.PCG64(0))
    shape = (4, environment.signature.max_steps, environment.signature.action.size)
    return _Case(control, environment, randomized, generator.uniform(-1, 1, shape).astype(np.float32))


def _joined(robot: str, task: str, control: str, randomization: dict[str, Distribution]) -> RobotTask:
    kinds: Any = load("robots", robot), load("tasks", task)
    return RobotTask(
        RobotTask.Settings.model_validate({}),
        robot=kinds[0](kinds[0].Settings(control=control)),
        task=kinds[1](kinds[1].Settings()),
        randomization=randomization,
    )


def _repeat(case: _Case, seed: int) -> None:
    """One episode to record the motor targets, one timed, one of physics alone; then a few resets."""
    environment, actions = case.environment, case.actions[seed % len(case.actions)]
    environment.reset(seed)
    with _recording() as targets:
        marks = [len(targets)]
        for action in actions:
            environment.step(action)
            marks.append(len(targets))

    environment.reset(seed)
    start = thread_time()
    for action in actions:
        environment.step(action)
    case.stepping.append((thread_time() - start) / len(actions))

    environment.reset(seed)
    world, spent = environment.world, 0.0
    for first, last in pairwise(marks):
        for body, arguments in targets[first:last]:
            body.drive(*arguments)
        start = thread_time()
        world.step()
        spent += thread_time() - start
    case.physics.append(spent / len(actions))

    start = thread_time()
    for number in range(20):
        environment.reset(seed + number)
    case.resetting.append((thread_time() - start) / 20)

    pair = [(environment, case.plain), (case.randomized, case.drawn)]
    for other, times in reversed(pair) if seed % 2 else pair:
        other.reset(seed)
        for action in actions[:10]:  # so that neither finds the caches cold
            if other.step(action).terminated:
                break
        start = thread_time()
        other.reset(seed)
        for action in actions:
            if other.step(action).terminated:
                break
        times.append(thread_time() - start)


@contextmanager
def _recording() -> Iterator[list[tuple[Body, tuple[Any, ...]]]]:
    """Keep what every body's motors are told."""
    kept: list[tuple[Body, tuple[Any, ...]]] = []
    drive = Body.drive

    def recorder(body: Body, *arguments: Any) -> None:
        kept.append((body, arguments))
        drive(body, *arguments)

    Body.drive = recorder  # type: ignore[assignment]
    try:
        yield kept
    finally:
        Body.drive = drive  # type: ignore[method-assign]
