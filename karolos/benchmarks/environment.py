"""How fast an environment steps, beside the bare physics of the same episodes, or beside panda-gym.

The bare physics loop replays the motor targets of the very same episodes and counts the time of the physics steps
alone. An arm that moves costs more than one at rest, so a loop that lets it come to rest would be an unfair peer.
Times are processor time of this thread.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import pairwise
from statistics import median
from time import thread_time
from typing import Any

import numpy as np

from ..core import Array
from ..environments.robot_task import RobotTask
from ..randomization.distributions import Distribution, Normal
from ..registry import load
from ..simulation.engines import Engine
from ..simulation.interface import Motors
from .side_by_side import Row, beside, require_modules, take_turns

NAME = "environment"
PHYSICS, PANDA_GYM = "bare physics loop", "panda-gym"
PANDA_GYM_TASKS = {
    "reach": ("karolos/PandaReach-v1", "PandaReach-v3"),
    "pick_place": ("karolos/PandaPickPlace-v1", "PandaPickAndPlace-v3"),
}
PANDA_GYM_STEPS = 50
"""Steps of an episode of either. panda-gym steps at 25 Hz, karolos at 24."""


def measure(
    robot: str = "panda",
    task: str = "reach",
    *,
    controls: Sequence[str] = ("joint", "cartesian"),
    engine: Engine | None = None,
    seconds: float = 10,
) -> list[Row]:
    """Steps per second, and resets, of one robot with one task under random actions, on one core.

    Args:
        robot: name of a robot.
        task: name of a task.
        controls: control modes of the robot.
        engine: physics engine; None: the default.
        seconds: time for all measurements together.

    Raises:
        UsageError: the robot or the task is unknown.
    """
    cases = {control: _Case(robot, task, control, engine) for control in controls}
    measured = take_turns(
        {
            (control, method.__name__): method
            for control, case in cases.items()
            for method in (case.steps, case.physics, case.reset, case.plain, case.randomized)
        },
        seconds=seconds,
    )
    rows = []
    for control, case in cases.items():
        case.close()
        name = f"{robot} {task} {control}"
        steps, physics, reset, plain, randomized = (measured[key] for key in measured if key[0] == control)
        rows += [
            beside(NAME, name, steps, "steps/s", PHYSICS, physics),
            Row(NAME, f"{name} reset", median(reset), "ms"),
            beside(NAME, f"{name} randomized episode", randomized, "episodes/s", "not randomized", plain),
        ]
    return rows


class _Case:
    """One control mode. Each method measures one thing in the episode of a seed."""

    def __init__(self, robot: str, task: str, control: str, engine: Engine | None) -> None:
        self._plain = _joined(robot, task, control, engine, {})
        parts = (("robot", self._plain.robot.parameters), ("task", self._plain.task.parameters))
        nominal: dict[str, Distribution] = {
            f"{part}.{name}": Normal(Normal.Settings(mean=parameter.nominal, std=0.0))
            for part, parameters in parts
            for name, parameter in parameters.items()
        }
        self._randomized = _joined(
            robot, task, control, engine, nominal
        )  # the same physics: each value drawn is nominal
        generator = np.random.Generator(np.random.PCG64(0))
        shape = (4, self._plain.signature.max_steps, self._plain.signature.action.size)
        self._actions: Array = generator.uniform(-1, 1, shape).astype(np.float32)

    def close(self) -> None:
        self._plain.close()
        self._randomized.close()

    def steps(self, seed: int) -> float:
        """Steps per second, the reset not counted."""
        actions = self._actions[seed % len(self._actions)]
        _play(self._plain, seed, actions)  # warms the caches
        self._plain.reset(seed)
        start = thread_time()
        for action in actions:
            self._plain.step(action)
        return len(actions) / (thread_time() - start)

    def physics(self, seed: int) -> float:
        """Steps per second of physics alone: the episode's ramps of the motors are recorded, then replayed."""
        environment, actions = self._plain, self._actions[seed % len(self._actions)]
        environment.reset(seed)
        with _recorded_ramps(environment) as ramps:
            marks = [len(ramps)]
            for action in actions:
                environment.step(action)
                marks.append(len(ramps))
        environment.reset(seed)
        world, seconds = environment.world, 0.0
        for first, last in pairwise(marks):
            for motors, arguments in ramps[first:last]:
                motors.drive(*arguments)
            start = thread_time()
            world.step()
            seconds += thread_time() - start
        return len(actions) / seconds

    def reset(self, seed: int) -> float:
        """Milliseconds per reset."""
        start = thread_time()
        for number in range(20):
            self._plain.reset(seed + number)
        return 1e3 * (thread_time() - start) / 20

    def plain(self, seed: int) -> float:
        """Episodes per second, from reset to reset."""
        return self._episodes_per_second(self._plain, seed)

    def randomized(self, seed: int) -> float:
        """Episodes per second with every parameter drawn at each reset."""
        return self._episodes_per_second(self._randomized, seed)

    def _episodes_per_second(self, environment: RobotTask, seed: int) -> float:
        actions = self._actions[seed % len(self._actions)]
        _play(environment, seed, actions[:10])  # warms the caches
        start = thread_time()
        _play(environment, seed, actions)
        return 1 / (thread_time() - start)


def _play(environment: RobotTask, seed: int, actions: Array) -> None:
    environment.reset(seed)
    for action in actions:
        if environment.step(action).terminated:
            break


def _joined(
    robot: str, task: str, control: str, engine: Engine | None, randomization: dict[str, Distribution]
) -> RobotTask:
    robot_class: Any = load("robots", robot)
    task_class: Any = load("tasks", task)
    return RobotTask(
        RobotTask.Settings.model_validate({} if engine is None else {"engine": engine}),
        robot=robot_class(robot_class.Settings(control=control)),
        task=task_class(task_class.Settings()),
        randomization=randomization,
    )


@contextmanager
def _recorded_ramps(environment: RobotTask) -> Iterator[list[tuple[Motors, tuple[Any, ...]]]]:
    """The motors of a robot and the arguments of their `drive`, in the order of the calls."""
    recorded: list[tuple[Motors, tuple[Any, ...]]] = []
    motors: Any = environment.robot._motors  # type: ignore[attr-defined]  # robots do not show their motors
    drive = motors.drive

    def recorder(*arguments: Any) -> None:
        recorded.append((motors, arguments))
        drive(*arguments)

    motors.drive = recorder
    try:
        yield recorded
    finally:
        del motors.drive  # the method of the class is found again


def measure_panda_gym(*, seconds: float = 10.0) -> list[Row]:
    """Steps per second of random episodes without their resets, both libraries by gymnasium's interface.

    Raises:
        MachineError: panda-gym is not installed.
    """
    require_modules("pip install --no-deps panda-gym", "panda_gym")
    import gymnasium  # noqa: PLC0415
    import panda_gym  # type: ignore[import-not-found]  # noqa: F401, PLC0415  (registers its environments)

    from .. import gym  # noqa: F401, PLC0415  (registers karolos's environments)

    rows = []
    for task, ids in PANDA_GYM_TASKS.items():
        if ids[0] not in gymnasium.registry:
            continue
        environments: list[Any] = [gymnasium.make(name).unwrapped for name in ids]
        contestants = {name: partial(_gymnasium_steps, one) for name, one in zip(ids, environments, strict=True)}
        ours, theirs = take_turns(contestants, seconds=seconds / len(PANDA_GYM_TASKS)).values()
        for environment in environments:
            environment.close()
        rows.append(beside(NAME, f"panda {task} cartesian", ours, "steps/s", PANDA_GYM, theirs))
    return rows


def _gymnasium_steps(environment: Any, seed: int) -> float:
    """Steps per second."""
    generator = np.random.Generator(np.random.PCG64(seed))
    actions = generator.uniform(-1, 1, (PANDA_GYM_STEPS, *environment.action_space.shape)).astype(np.float32)
    environment.reset(seed=seed)
    start = thread_time()
    for action in actions:
        environment.step(action)
    return PANDA_GYM_STEPS / (thread_time() - start)
