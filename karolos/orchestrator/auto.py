"""The orchestrator that measures layouts on this machine and uses a fast one."""

from __future__ import annotations

import itertools
import os
import pickle
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Setting

from ..core import Orchestrator, Received, random_actions
from ..environments.build import build_environment
from .executor import Build
from .local import MAX_ENVIRONMENTS, Limits, Local

THREADS = 4
"""Threads per process that the probe tries with the best number of processes."""
PROBE_ROUNDS = 64
"""Rounds of random actions that are drawn before the measurement and then repeated."""
SPEEDUP = 1.1
"""A layout with more workers must be faster by this factor, because workers take memory and the learner's cores."""


_probed: dict[bytes, list[Measured]] = {}
"""Measurements of this process by robot, task and settings, so that a run's tests need no second probe."""


class Auto(Local):
    """A local orchestrator with the layout that was fastest in a probe of a few seconds.

    Results do not depend on the layout. A spec with `auto` and a spec with `local` and the same number of environments
    are the same experiment. `describe` returns the measurements and the chosen layout.
    """

    class Settings(Limits):
        environments: int = Setting(default=8, ge=1, le=MAX_ENVIRONMENTS, description="number of environments")
        seconds: float = Setting(
            default=3.0,
            gt=0,
            le=3600,
            description="seconds of stepping in the probe; starting its workers takes additional time",
        )

        @property
        def size(self) -> int:
            """Number of environments."""
            return self.environments

        def identity(self) -> dict[str, Any]:
            """The settings that results depend on: those of a local orchestrator of this size."""
            return {"name": "local", "environments": self.environments}

    def __init__(self, settings: Auto.Settings, recipe: Any, *, build: Build = build_environment) -> None:
        """Measure layouts, choose one, and start its workers.

        Raises:
            KarolosError: as `Local`.
        """
        key = pickle.dumps((build, getattr(recipe, "robot", recipe), getattr(recipe, "task", None), settings))
        if key not in _probed:
            _probed[key] = probe(recipe, settings.environments, settings.seconds, build)
        self.measured = _probed[key]
        chosen = choose(self.measured)
        limits = settings.model_dump(include=set(Limits.model_fields))
        layout = Local.Settings(processes=chosen.processes, threads=chosen.threads, **limits)
        super().__init__(layout, recipe, size=settings.environments, build=build)

    def describe(self) -> dict[str, Any]:
        """The chosen layout, and all measured layouts with their steps per second."""
        return {**super().describe(), "measured": [asdict(one) for one in self.measured]}


@dataclass(frozen=True)
class Measured:
    """A layout and its speed."""

    processes: int
    threads: int
    steps_per_second: float


def cores() -> int:
    """Number of CPU cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def steps_per_second(orchestrator: Orchestrator, seconds: float) -> float:
    """Environment steps per second of wall-clock time with random actions in lockstep, including resets."""
    everything = np.arange(orchestrator.size)
    generator = np.random.Generator(np.random.PCG64(0))
    actions = [random_actions(orchestrator.signature, orchestrator.size, generator) for _ in range(PROBE_ROUNDS)]
    seeds = itertools.count()

    def begin(environments: NDArray[np.int64]) -> None:
        """Begin an episode in each of these environments, and again where it fails or is over at once."""
        while environments.size:
            orchestrator.reset(environments, [next(seeds) for _ in environments])
            environments = over(orchestrator.receive())

    def over(received: Received) -> NDArray[np.int64]:
        ends = received.environment[received.step.terminated | received.step.truncated]
        return np.union1d(ends, received.failed)

    begin(everything)
    steps, started = 0, perf_counter()
    for drawn in itertools.cycle(actions):
        orchestrator.step(everything, drawn)
        received = orchestrator.receive()
        steps += received.environment.size
        begin(over(received))
        elapsed = perf_counter() - started
        if elapsed >= seconds:
            break
    return steps / elapsed


def probe(recipe: Any, size: int, seconds: float, build: Build = build_environment) -> list[Measured]:
    """Measure layouts of `size` environments: first 1, 2, 4 ... processes until one is slower, then threads.

    Args:
        seconds: of stepping in total, without starting the workers.

    Raises:
        KarolosError: an environment cannot be built, or fails.
    """
    counts = list(process_counts(min(cores(), size)))
    seconds_each = seconds / (len(counts) + 2)

    def measured(processes: int, threads: int) -> Measured:
        layout = Local.Settings(processes=processes, threads=threads)
        with Local(layout, recipe, size=size, build=build) as orchestrator:
            return Measured(processes, threads, steps_per_second(orchestrator, seconds_each))

    found: list[Measured] = []
    for count in counts:
        found.append(measured(count, 1))
        if len(found) > 1 and found[-1].steps_per_second < found[-2].steps_per_second:
            break
    best = choose(found)
    if size // best.processes > 1:
        found.append(measured(best.processes, min(THREADS, size // best.processes)))
    found.append(measured(0, 1))
    return found


def process_counts(most: int) -> Iterator[int]:
    """Numbers of processes to try: 1, 2, 4 ... and `most`."""
    count = 1
    while count < most:
        yield count
        count *= 2
    yield most


def choose(measured: Sequence[Measured]) -> Measured:
    """The layout to use: the fastest, or one with fewer workers that is nearly as fast.

    A layout without processes comes last, because the main process cannot step while the agent learns.
    """
    fastest = max(one.steps_per_second for one in measured)
    close = [one for one in measured if one.steps_per_second * SPEEDUP >= fastest]
    return min(close, key=lambda one: (one.processes == 0, one.processes * one.threads))
