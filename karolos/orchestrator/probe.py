"""How fast a layout steps, measured; and which layout a machine should use."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from time import perf_counter
from typing import Any

import numpy as np

from ..core import Orchestrator, random_actions
from ..environments.build import build_environment
from .commands import Build
from .local import Local

THREADS = 4
"""Threads per process that are tried once the number of processes is known."""
DRAWN = 64
"""Rounds of random actions that are drawn before the clock starts, and played again and again."""
WORTHWHILE = 1.1
"""How many times faster a layout with more workers has to be: each takes memory, and time of the learner's cores."""


@dataclass(frozen=True)
class Measured:
    """One layout and what it did."""

    processes: int
    threads: int
    steps_per_second: float

    def dump(self) -> dict[str, Any]:
        return asdict(self)


def cores() -> int:
    """How many CPU cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def laid_out(recipe: Any, size: int, processes: int, threads: int, build: Build = build_environment) -> Local:
    """`size` environments over processes x threads."""
    return Local(Local.Settings(processes=processes, threads=threads), recipe, size=size, build=build)


def steps_per_second(orchestrator: Orchestrator, seconds: float) -> float:
    """Environment steps per second of wall-clock time under random actions in lockstep, the resets of finished
    episodes included.
    """
    everything = np.arange(orchestrator.size)
    generator = np.random.Generator(np.random.PCG64(0))
    actions = [random_actions(orchestrator.signature, orchestrator.size, generator) for _ in range(DRAWN)]
    orchestrator.reset(everything, range(orchestrator.size))
    orchestrator.receive()
    steps, started = 0, perf_counter()
    for drawn in itertools.cycle(actions):
        orchestrator.step(everything, drawn)
        step = orchestrator.receive().step
        steps += orchestrator.size
        over = np.flatnonzero(step.terminated | step.truncated)
        if over.size:
            orchestrator.reset(over, (steps + over).tolist())
            orchestrator.receive()
        elapsed = perf_counter() - started
        if elapsed >= seconds:
            break
    return steps / elapsed


def probe(recipe: Any, size: int, seconds: float, build: Build = build_environment) -> list[Measured]:
    """What `size` environments do in different layouts: processes first, doubled as long as that pays, then threads.

    Args:
        seconds: of stepping in all; starting the workers comes on top.

    Raises:
        KarolosError: an environment cannot be built, or fails.
    """
    counts = list(process_counts(min(cores(), size)))
    share = seconds / (len(counts) + 2)

    def measured(processes: int, threads: int) -> Measured:
        with laid_out(recipe, size, processes, threads, build) as orchestrator:
            return Measured(processes, threads, steps_per_second(orchestrator, share))

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
    """Numbers of processes to try: 1, 2, 4 ... and the most."""
    count = 1
    while count < most:
        yield count
        count *= 2
    yield most


def choose(measured: Sequence[Measured]) -> Measured:
    """The layout to use: the fastest, unless one with fewer workers comes close.

    No process at all counts as the most costly: what steps in the main process cannot step while the agent learns.
    """
    fastest = max(found.steps_per_second for found in measured)
    close = [found for found in measured if found.steps_per_second * WORTHWHILE >= fastest]
    return min(close, key=lambda found: (found.processes == 0, found.processes * found.threads))
