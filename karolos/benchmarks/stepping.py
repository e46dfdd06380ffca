"""Steps per second of the environments of an orchestrator."""

from __future__ import annotations

import itertools
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from ..core import Orchestrator, Received, random_actions

ROUNDS_OF_ACTIONS = 64
"""Rounds of random actions that are drawn before the measurement and then repeated."""


def steps_per_second(orchestrator: Orchestrator, seconds: float) -> float:
    """Environment steps per second of wall-clock time with random actions in lockstep, including resets."""
    everything = np.arange(orchestrator.size)
    actions = rounds_of_actions(orchestrator)
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


def rounds_of_actions(orchestrator: Orchestrator) -> list[NDArray[np.float32]]:
    """Random actions for all environments, for a number of rounds."""
    generator = np.random.Generator(np.random.PCG64(0))
    return [random_actions(orchestrator.signature, orchestrator.size, generator) for _ in range(ROUNDS_OF_ACTIONS)]
