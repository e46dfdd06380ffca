"""How fast buffers store and sample, and how much memory they take: 1M pick-and-place transitions from 16 environments.

As in training, a batch follows each step of the environments, so that each finds what the other has left of the caches.
The times are medians over many calls in turn, because a machine is never alone.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np

from ..buffers.storage import row_layout
from ..core import FloatArray, Signature, Transitions
from ..core.seeding import SeedTree
from ..environments.build import build_environment
from ..registry import load
from ..spec import Spec
from .row import Row

ENVIRONMENTS, BATCH = 16, 256
ADDED = 1_000
"""Transitions of the measurement of adding."""
SPEC = {"robot": "panda", "task": "pick_place", "agent": "sac"}
_STATM = Path("/proc/self/statm")


@dataclass
class _Case:
    """A full buffer, and how long it takes to do what training asks of it."""

    name: str
    buffer: Any
    adding: list[float] = field(default_factory=list)
    """Milliseconds for each ADDED transitions."""
    sampling: list[float] = field(default_factory=list)
    """Milliseconds for each batch, its priorities updated where there are some."""

    def turn(self, source: _Source, errors: FloatArray) -> None:
        """As many steps as give ADDED transitions, a batch after each: what came in since enters the sum tree then."""
        adding = 0.0
        for _ in range(ADDED // ENVIRONMENTS):
            transitions = source.next()
            started = perf_counter()
            self.buffer.add(transitions)
            added = perf_counter()
            batch = self.buffer.sample(BATCH)
            if self.name == "priority":
                self.buffer.update_priorities(batch.slot, errors)
            ended = perf_counter()
            adding += added - started
            self.sampling.append(1e3 * (ended - added))
        self.adding.append(1e3 * adding)


def measure(*, transitions: int = 1_000_000, seconds: float = 10.0) -> Iterator[Row]:
    """Milliseconds per call and gigabytes of memory.

    Args:
        transitions: how many the buffers hold.
        seconds: for all measurements of time together, beside filling the buffers.
    """
    environment = build_environment(Spec.from_dict(dict(SPEC)).recipe(randomize=False))
    signature = environment.signature
    environment.close()
    source, cases = _Source(signature), []
    size = f"{transitions:,} transitions"
    for name in ("uniform", "priority"):
        before = _resident()
        cases.append(_Case(name, _filled(name, signature, source, transitions)))
        if before is not None:
            yield Row("buffers", f"{name}, memory of {size}", ((_resident() or 0) - before) / 1e9, "GB")
    layout = row_layout(signature).size * 4 * transitions / 1e9
    yield Row("buffers", f"rows of {size} as laid out", layout, "GB")
    errors = np.random.Generator(np.random.PCG64(1)).random(BATCH, np.float32)
    end, turns = perf_counter() + seconds, 0
    while perf_counter() < end or turns < 10:
        for case in cases:
            case.turn(source, errors)
        turns += 1
    for case in cases:
        update = ", priorities updated" if case.name == "priority" else ""
        what = f"{case.name}, batch of {BATCH} with hindsight{update}"
        yield Row("buffers", what, median(case.sampling), "ms")
        what = f"{case.name}, adding {ADDED:,} transitions of {ENVIRONMENTS} environments"
        yield Row("buffers", what, median(case.adding), "ms")


class _Source:
    """Transitions that agree with the goal rule, over and over: the noise of one episode in each environment."""

    def __init__(self, signature: Signature) -> None:
        generator = np.random.Generator(np.random.PCG64(0))
        rule = signature.goal_rule
        assert rule is not None, "pick_place has goals"
        self._episode = []
        self._step = 0

        def noise(columns: int) -> Any:
            return generator.standard_normal((ENVIRONMENTS, columns), np.float32)

        observation, achieved = noise(signature.observation.size), noise(signature.achieved_goal.size)
        desired = noise(signature.desired_goal.size)
        for step in range(signature.max_steps):
            following, reached = noise(signature.observation.size), noise(signature.achieved_goal.size)
            self._episode.append(
                Transitions(
                    environment=np.arange(ENVIRONMENTS),
                    observation=observation,
                    achieved_goal=achieved,
                    desired_goal=desired,
                    action=noise(signature.action.size),
                    reward=rule.reward(reached, desired),
                    next_observation=following,
                    next_achieved_goal=reached,
                    terminated=rule.terminated(reached, desired),
                    truncated=np.full(ENVIRONMENTS, step == signature.max_steps - 1),
                )
            )
            observation, achieved = following, reached

    def next(self) -> Transitions:
        self._step += 1
        return self._episode[(self._step - 1) % len(self._episode)]


def _filled(name: str, signature: Signature, source: _Source, transitions: int) -> Any:
    kind: Any = load("buffers", name)
    settings = kind.Settings(capacity=transitions, hindsight={"strategy": "future", "ratio": 0.8})
    buffer = kind(settings, signature, SeedTree(0), environments=ENVIRONMENTS, discount=0.95)
    for _ in range(transitions // ENVIRONMENTS):
        buffer.add(source.next())
    buffer.sample(BATCH)
    return buffer


def _resident() -> int | None:
    """Bytes of memory that this process has in use; None where the system does not tell."""
    if not _STATM.exists():
        return None
    return int(_STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
