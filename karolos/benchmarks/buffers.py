"""How fast buffers store and sample, and how much memory they take: 1M pick-and-place transitions from 16 environments.

As in training, a batch follows each step of the environments, so that adding and sampling compete for the caches.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np

from ..buffers.storage import row_layout
from ..core import Discrete, Signature, Transitions
from ..core.seeding import SeedTree
from ..environments.build import build_environment
from ..registry import load
from ..spec import spec_from_dict
from .side_by_side import Row, take_turns

NAME = "buffers"
ENVIRONMENTS, BATCH = 16, 256
ADDED = 1_000
"""Transitions that are added in a turn."""
SPEC = {"robot": "panda", "task": "pick_place", "agent": "sac"}
_STATM = Path("/proc/self/statm")


def measure(*, transitions: int = 1_000_000, seconds: float = 10.0) -> Iterator[Row]:
    """Milliseconds per call and gigabytes of memory.

    Args:
        transitions: number of transitions in each buffer.
        seconds: for all measurements of time together; filling the buffers comes on top.
    """
    environment = build_environment(spec_from_dict(dict(SPEC)).recipe(randomize=False))
    signature = environment.signature
    environment.close()
    hindsight = {"strategy": "future", "ratio": 0.8}
    source, buffers = NoiseEpisode(signature, ENVIRONMENTS), {}
    size = f"{transitions:,} transitions"
    for name in ("uniform", "priority"):
        before = _resident()
        buffers[name] = filled_buffer(name, signature, source, transitions, hindsight=hindsight)
        if before is not None:
            yield Row(NAME, f"{name}, memory of {size}", ((_resident() or 0) - before) / 1e9, "GB")
    layout = row_layout(signature).size * 4 * transitions / 1e9
    yield Row(NAME, f"rows of {size} as laid out", layout, "GB")
    contestants = {name: partial(_milliseconds, buffer, source) for name, buffer in buffers.items()}
    for name, turns in take_turns(contestants, turns=10, seconds=seconds).items():
        update = ", priorities updated" if name == "priority" else ""
        adding, sampling = (median(times) for times in zip(*turns, strict=True))
        yield Row(NAME, f"{name}, batch of {BATCH} with hindsight{update}", sampling, "ms")
        yield Row(NAME, f"{name}, adding {ADDED:,} transitions of {ENVIRONMENTS} environments", adding, "ms")


def _milliseconds(buffer: Any, source: NoiseEpisode, turn: int) -> tuple[float, float]:
    """Milliseconds to add ADDED transitions, and the median of those to sample a batch after each step.

    Sampling includes the update of priorities: new transitions enter the sum tree at the next sampling.
    """
    errors = np.random.Generator(np.random.PCG64(turn)).random(BATCH, np.float32)
    adding, sampling = 0.0, []
    for _ in range(ADDED // ENVIRONMENTS):
        transitions = source.next()
        started = perf_counter()
        buffer.add(transitions)
        added = perf_counter()
        batch = buffer.sample(BATCH)
        buffer.update_priorities(batch.slot, errors)
        sampling.append(perf_counter() - added)
        adding += added - started
    return 1e3 * adding, 1e3 * median(sampling)


class NoiseEpisode:
    """Repeats one episode of noise in each environment. The goal rule, if any, gives the rewards and ends."""

    def __init__(self, signature: Signature, environments: int) -> None:
        generator = np.random.Generator(np.random.PCG64(0))
        rule, actions = signature.goal_rule, signature.action
        self.environments = environments
        self._steps = []
        self._count = 0

        def noise(columns: int) -> Any:
            return generator.standard_normal((environments, columns), np.float32)

        observation, achieved = noise(signature.observation.size), noise(signature.achieved_goal.size)
        desired = noise(signature.desired_goal.size)
        for step in range(signature.max_steps):
            next_observation, reached = noise(signature.observation.size), noise(signature.achieved_goal.size)
            if isinstance(actions, Discrete):
                action: Any = generator.integers(len(actions.labels), size=(environments, 1))
            else:
                action = generator.uniform(-1, 1, (environments, actions.size))
            self._steps.append(
                Transitions(
                    environment=np.arange(environments),
                    observation=observation,
                    achieved_goal=achieved,
                    desired_goal=desired,
                    action=action.astype(np.float32),
                    reward=rule.reward(reached, desired) if rule else -generator.random(environments, np.float32),
                    next_observation=next_observation,
                    next_achieved_goal=reached,
                    terminated=rule.terminated(reached, desired) if rule else np.zeros(environments, np.bool_),
                    truncated=np.full(environments, step == signature.max_steps - 1),
                )
            )
            observation, achieved = next_observation, reached

    def next(self) -> Transitions:
        self._count += 1
        return self._steps[(self._count - 1) % len(self._steps)]


def filled_buffer(name: str, signature: Signature, source: NoiseEpisode, transitions: int, **settings: Any) -> Any:
    """A full buffer that has been sampled once."""
    kind: Any = load("buffers", name)
    chosen, environments = kind.Settings(capacity=transitions, **settings), source.environments
    buffer = kind(chosen, signature, SeedTree(0), environments=environments, discount=0.95)
    for _ in range(transitions // environments):
        buffer.add(source.next())
    buffer.sample(BATCH)
    return buffer


def _resident() -> int | None:
    """Bytes of memory that this process has in use; None where the system does not say."""
    if not _STATM.exists():
        return None
    return int(_STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
