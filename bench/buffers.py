"""How fast buffers store and sample, and how much memory they take: 1M pick-and-place transitions from 16 environments.

As in training, a batch follows each step of the environments, so that adding and sampling compete for the caches.
"""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from functools import partial
from itertools import cycle, islice
from statistics import median
from time import perf_counter
from typing import Annotated, Any

import numpy as np
from typer import Option

from karolos.core import FloatArray, Layout, Signature, Transitions, random_actions
from karolos.core.experience import transition_layout
from karolos.core.seeding import SeedTree
from karolos.plugins.inspection import pair
from karolos.registry import load

from .side_by_side import Row, take_turns

ENVIRONMENTS, BATCH = 16, 256
ADDED = 1_000
"""Transitions that are added in a turn."""


def measure(*, transitions: Annotated[int, Option(min=1000)] = 1_000_000, seconds: float = 10.0) -> Iterator[Row]:
    """Milliseconds per call and gigabytes of memory.

    Args:
        transitions: number of transitions in each buffer.
        seconds: for all measurements of time together; filling the buffers comes on top.
    """
    signature = pair("panda", "pick_place").signature
    size, contestants = f"{transitions:,} transitions", {}
    for name in ("uniform", "priority"):
        fill = partial(filled_buffer, name, signature, ENVIRONMENTS, hindsight={"strategy": "future", "ratio": 0.8})
        fill(1000)  # it imports modules, which are not the buffer's memory
        # Traced: the resident pages of the process also depend on what others have freed and what the kernel takes.
        tracemalloc.start()
        buffer = fill(transitions)
        memory, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        yield Row(f"{name}, memory of {size}", memory / 1e9, "GB")
        contestants[name] = partial(_milliseconds, buffer, noise_episode(signature, ENVIRONMENTS))
    layout = transition_layout(signature).size * 4 * transitions / 1e9
    yield Row(f"rows of {size} as laid out", layout, "GB")
    for name, turns in take_turns(contestants, turns=10, seconds=seconds).items():
        update = ", priorities updated" if name == "priority" else ""
        adding, sampling = (median(times) for times in zip(*turns, strict=True))
        yield Row(f"{name}, batch of {BATCH} with hindsight{update}", sampling, "ms")
        yield Row(f"{name}, adding {ADDED:,} transitions of {ENVIRONMENTS} environments", adding, "ms")


def _milliseconds(buffer: Any, noise: Iterator[Transitions], turn: int) -> tuple[float, float]:
    """Milliseconds to add ADDED transitions, and the median of those to sample a batch after each step.

    Sampling includes the update of priorities: new transitions enter the sum tree at the next sampling.
    """
    errors = np.random.Generator(np.random.PCG64(turn)).random(BATCH, np.float32)
    adding, sampling = 0.0, []
    for _ in range(ADDED // ENVIRONMENTS):
        transitions = next(noise)
        started = perf_counter()
        buffer.add(transitions)
        added = perf_counter()
        batch = buffer.sample(BATCH)
        buffer.update_priorities(batch.slot, errors)
        sampling.append(perf_counter() - added)
        adding += added - started
    return 1e3 * adding, 1e3 * median(sampling)


def noise_episode(signature: Signature, environments: int) -> Iterator[Transitions]:
    """Repeats one episode of noise in each environment. The goal rule, if any, gives the rewards and ends."""
    generator = np.random.Generator(np.random.PCG64(0))
    rule, length = signature.goal_rule, signature.max_steps

    def noise(layout: Layout) -> FloatArray:
        """One more row than steps: the last is what the last step leads to."""
        return generator.standard_normal((length + 1, environments, layout.size), np.float32)

    observed, achieved = noise(signature.observation), noise(signature.achieved_goal)
    desired, rewards = noise(signature.desired_goal)[0], -generator.random((length + 1, environments), np.float32)
    steps = [
        Transitions(
            environment=np.arange(environments),
            observation=observed[step],
            achieved_goal=achieved[step],
            desired_goal=desired,
            action=random_actions(signature, environments, generator),
            reward=rule.reward(achieved[step + 1], desired) if rule else rewards[step],
            next_observation=observed[step + 1],
            next_achieved_goal=achieved[step + 1],
            terminated=rule.terminated(achieved[step + 1], desired) if rule else np.zeros(environments, np.bool_),
            truncated=np.full(environments, step == length - 1),
        )
        for step in range(length)
    ]
    return cycle(steps)


def filled_buffer(name: str, signature: Signature, environments: int, transitions: int, **settings: Any) -> Any:
    """A full buffer that has been sampled once."""
    kind: Any = load("buffers", name)
    chosen = kind.Settings(capacity=transitions, **settings)
    buffer = kind(chosen, signature, SeedTree(0), environments=environments, discount=0.95)
    for noise in islice(noise_episode(signature, environments), transitions // environments):
        buffer.add(noise)
    buffer.sample(BATCH)
    return buffer
