"""Steps per second of an environment, compared with bare physics or with panda-gym.

Physics is timed inside the steps: an arm that moves costs more than one at rest, so that a loop of physics without
actions would be an unfair peer. Times are processor time of this thread.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from statistics import median
from time import thread_time
from typing import Any, Literal, get_args

import gymnasium
import numpy as np

from karolos.core import FloatArray, random_actions
from karolos.environments.robot_task import RobotTask
from karolos.plugins.inspection import pair
from karolos.registry import load
from karolos.simulation.engines import Engine

from .side_by_side import Row, beside, require, seconds_of, take_turns

PANDA_GYM_TASKS = {
    "reach": ("karolos/PandaReach-v1", "PandaReach-v3"),
    "pick_place": ("karolos/PandaPickPlace-v2", "PandaPickAndPlace-v3"),
}
PANDA_GYM_STEPS = 50
"""Steps of an episode of either. panda-gym steps at 25 Hz, karolos at 24."""
Control = Literal["joint", "cartesian"]


def measure(
    *,
    robot: str = "panda",
    task: str = "reach",
    control: Control | None = None,
    engine: Engine | None = None,
    peers: bool = False,
    seconds: float = 10.0,
) -> Iterator[Row]:
    """Steps per second, and resets, of one robot with one task under random actions, on one core.

    Args:
        control: control mode of the robot; None: both.
        peers: measure Panda's tasks beside panda-gym's instead.
        seconds: time for all measurements together.
    """
    if peers:
        yield from _beside_panda_gym(engine, seconds)
        return
    modes: tuple[Control, ...] = (control,) if control else get_args(Control)
    contestants: dict[tuple[str, str], Any] = {}
    for mode in modes:
        plain, randomized = (pair(robot, task, engine, control=mode) for _ in range(2))
        # Each value drawn is nominal, so that the physics is the same.
        normal = load("distributions", "normal")
        nominal = {name: normal(normal.Settings(mean=one.nominal, std=0.0)) for name, one in plain.declared.items()}
        randomized.randomize(nominal)
        contestants[mode, "steps"] = partial(_steps_and_physics, plain)
        contestants[mode, "reset"] = partial(_reset, plain)
        contestants[mode, "plain"] = partial(_episodes, plain)
        contestants[mode, "randomized"] = partial(_episodes, randomized)
    measured: dict[tuple[str, str], list[Any]] = take_turns(contestants, seconds=seconds)
    for mode in modes:
        name = f"{robot} {task} {mode}"
        steps, physics = zip(*measured[mode, "steps"], strict=True)
        yield beside(name, steps, "steps/s", "bare physics loop", physics)
        yield Row(f"{name} reset", median(measured[mode, "reset"]), "ms")
        fast, slow = measured[mode, "plain"], measured[mode, "randomized"]
        yield beside(f"{name} randomized episode", slow, "episodes/s", "not randomized", fast)


def _steps_and_physics(environment: RobotTask, seed: int) -> tuple[float, float]:
    """Steps per second without the reset, and steps per second of their physics alone, less what the clock costs."""
    actions = _warmed(environment, seed)
    environment.reset(seed)
    clock = seconds_of(lambda: [thread_time() for _ in actions], thread_time)
    world: Any = environment.world
    step, physics = world.step, 0.0

    def timed() -> None:
        nonlocal physics
        physics += seconds_of(step, thread_time)

    world.step = timed
    whole = seconds_of(partial(_play, environment, actions), thread_time)
    world.step = step
    return len(actions) / (whole - 2 * clock), len(actions) / (physics - clock)


def _reset(environment: RobotTask, seed: int) -> float:
    """Milliseconds per reset."""
    return 1e3 / 20 * seconds_of(lambda: [environment.reset(seed + k) for k in range(20)], thread_time)


def _episodes(environment: RobotTask, seed: int) -> float:
    """Episodes per second, from reset to reset."""
    actions = _warmed(environment, seed)
    return 1 / seconds_of(lambda: (environment.reset(seed), _play(environment, actions)), thread_time)


def _warmed(environment: RobotTask, seed: int) -> FloatArray:
    """Random actions (steps, n) until the episode of this seed ends. They are played, which warms the caches."""
    signature = environment.signature
    actions = random_actions(signature, signature.max_steps, np.random.Generator(np.random.PCG64(seed)))
    environment.reset(seed)
    return actions[: _play(environment, actions)]


def _play(environment: RobotTask, actions: FloatArray) -> int:
    """Step until the actions or the episode end; returns the number of steps."""
    count, over = 0, False
    while not over and count < len(actions):
        step = environment.step(actions[count])
        count, over = count + 1, bool(step.terminated or step.truncated)
    return count


def _beside_panda_gym(engine: Engine | None, seconds: float) -> Iterator[Row]:
    """Steps per second of random episodes without their resets, both libraries by gymnasium's interface."""
    require("panda_gym", hint="pip install --no-deps panda-gym")
    import panda_gym  # type: ignore[import-not-found]  # noqa: F401, PLC0415  (registers its environments)

    from karolos import gym  # noqa: F401, PLC0415  (registers karolos's environments)

    def rate(environment: Any, seed: int) -> float:
        generator = np.random.Generator(np.random.PCG64(seed))
        actions = generator.uniform(-1, 1, (PANDA_GYM_STEPS, *environment.action_space.shape)).astype(np.float32)
        environment.reset(seed=seed)
        return PANDA_GYM_STEPS / seconds_of(lambda: [environment.step(action) for action in actions], thread_time)

    for task, ids in PANDA_GYM_TASKS.items():
        settings: list[dict[str, Any]] = [{} if engine is None else {"engine": engine}, {}]
        environments = [gymnasium.make(name, **more).unwrapped for name, more in zip(ids, settings, strict=True)]
        contestants = {one: partial(rate, one) for one in environments}
        ours, theirs = take_turns(contestants, seconds=seconds / len(PANDA_GYM_TASKS)).values()
        for environment in environments:
            environment.close()
        yield beside(f"panda {task} cartesian", ours, "steps/s", "panda-gym", theirs)
