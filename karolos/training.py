"""The training loop as a generator: no files, no database, no terminal.

One round, in lockstep: act for all environments, send the actions, learn from what the buffer already holds while the
environments step, receive, store. The order and the amounts depend on counts only, never on timing, so that a run is
the same bit for bit whatever the machine is busy with.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from .core import Agent, Buffer, Discrete, FloatArray, Orchestrator, Signature, Step, Transitions
from .schedules import Ratio
from .seeding import SeedTree


class Amounts(Protocol):
    """How much to train (spec key `training`)."""

    @property
    def steps(self) -> int: ...
    @property
    def batch_size(self) -> int: ...
    @property
    def replay_ratio(self) -> float: ...
    @property
    def warmup_episodes(self) -> int: ...


@dataclass(frozen=True)
class Episode:
    """The record of one training episode; `any`, `end`, `reset` as in a test."""

    environment: int
    index: int
    """Which of this environment's episodes it is, from 0."""
    seed: int
    steps: int
    total_reward: float
    any: bool
    end: bool
    reset: bool
    diverged: bool
    """Whether the simulation left all sense and cut it short."""
    parameters: tuple[float, ...]
    """What domain randomization drew, as `signature.parameters` lays it out."""


@dataclass(frozen=True)
class Progress:
    """Where training stands after a round."""

    steps: int
    episodes: int
    updates: int
    seconds: float
    """Wall-clock seconds of collecting and learning; what the caller does between rounds is not counted."""
    finished: tuple[Episode, ...] = ()
    metrics: tuple[Mapping[str, Any], ...] = ()
    """What `agent.learn` returned for each update of the round."""


@dataclass
class _Running:
    """What is being counted of the episode that each environment plays."""

    index: np.ndarray
    seed: np.ndarray
    steps: np.ndarray
    total_reward: np.ndarray
    any: np.ndarray
    end: np.ndarray
    reset: np.ndarray
    parameters: FloatArray

    @classmethod
    def none(cls, size: int, parameters: int) -> _Running:
        return cls(
            index=np.full(size, -1),
            seed=np.zeros(size, np.int64),
            steps=np.zeros(size, np.int64),
            total_reward=np.zeros(size),
            any=np.zeros(size, np.bool_),
            end=np.zeros(size, np.bool_),
            reset=np.zeros(size, np.bool_),
            parameters=np.zeros((size, parameters), np.float32),
        )

    def record(self, environment: int, diverged: bool) -> Episode:
        return Episode(
            environment=environment,
            index=int(self.index[environment]),
            seed=int(self.seed[environment]),
            steps=int(self.steps[environment]),
            total_reward=float(self.total_reward[environment]),
            any=bool(self.any[environment]),
            end=bool(self.end[environment]),
            reset=bool(self.reset[environment]),
            diverged=bool(diverged),
            parameters=tuple(self.parameters[environment].tolist()),
        )


@dataclass
class Training:
    """Trains one agent. `rounds()` is the loop; the caller may stop between any two rounds."""

    orchestrator: Orchestrator
    agent: Agent
    buffer: Buffer
    amounts: Amounts
    seeds: SeedTree
    steps: int = 0
    episodes: int = 0
    updates: int = 0
    seconds: float = 0.0
    _latest: Step | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        size, signature = self.orchestrator.size, self.orchestrator.signature
        self._all = np.arange(size)
        self._running = _Running.none(size, signature.parameters.size)
        self._due = Ratio(self.amounts.replay_ratio / self.amounts.batch_size)
        self._learning_since: int | None = None
        self._warmup = self.seeds.child("warmup").generator()

    def rounds(self) -> Iterator[Progress]:
        """Rounds until `amounts.steps` environment steps are taken."""
        while self.steps < self.amounts.steps:
            started = time.perf_counter()
            if self._latest is None:
                self._latest = self._begin()
            finished, metrics = self._round(self._latest)
            self.seconds += time.perf_counter() - started
            yield Progress(self.steps, self.episodes, self.updates, self.seconds, finished, metrics)

    def _begin(self) -> Step:
        self._reset(self._all)
        step = self.orchestrator.receive().step
        self._note_reset(self._all, step)
        return step

    def _round(self, before: Step) -> tuple[tuple[Episode, ...], tuple[Mapping[str, Any], ...]]:
        actions = self._act(before)
        self.orchestrator.step(self._all, actions)
        metrics = self._learn()
        after = self.orchestrator.receive().step
        self._store(before, actions, after)
        self.steps += self._all.size
        running = self._running
        running.steps += 1
        running.total_reward += after.reward
        running.any |= after.success
        running.end[:] = after.success
        over = np.flatnonzero(after.terminated | after.truncated)
        finished = tuple(running.record(environment, after.diverged[environment]) for environment in over.tolist())
        self.episodes += len(finished)
        self._latest = self._next_episodes(over, after) if finished else after
        return finished, metrics

    def _store(self, before: Step, actions: FloatArray, after: Step) -> None:
        transitions = Transitions(
            environment=self._all,
            observation=before.observation,
            achieved_goal=before.achieved_goal,
            desired_goal=before.desired_goal,
            action=actions,
            reward=after.reward,
            next_observation=after.observation,
            next_achieved_goal=after.achieved_goal,
            terminated=after.terminated,
            truncated=after.truncated,
        )
        if after.diverged.any():  # what the simulation made of these steps is no experience
            sound = ~after.diverged
            transitions = Transitions(*(field[sound] for field in transitions))
            self.buffer.cut(self._all[after.diverged])
        if transitions.environment.size:
            self.buffer.add(transitions)

    def _act(self, before: Step) -> FloatArray:
        if self.episodes < self.amounts.warmup_episodes:
            return random_actions(self.orchestrator.signature, self._all.size, self._warmup)
        if self._learning_since is None:
            self._learning_since = self.steps
        return self.agent.act(before.observation, before.desired_goal, explore=True)

    def _learn(self) -> tuple[Mapping[str, Any], ...]:
        """The updates that are due: the replay ratio counts the steps since warm-up ended."""
        if self._learning_since is None:
            return ()
        metrics = []
        for _ in range(self._due(self.steps - self._learning_since)):
            batch = self.buffer.sample(self.amounts.batch_size)
            result = dict(self.agent.learn(batch))
            priorities = result.pop("priorities", None)
            if priorities is not None:
                self.buffer.update_priorities(batch.slot, priorities)
            metrics.append(result)
        self.updates += len(metrics)
        return tuple(metrics)

    def _reset(self, environments: np.ndarray) -> None:
        self._running.index[environments] += 1
        seeds = [
            self.seeds.child("environment", environment, int(self._running.index[environment])).integer()
            for environment in environments.tolist()
        ]
        self._running.seed[environments] = seeds
        self.orchestrator.reset(environments, seeds)

    def _next_episodes(self, over: np.ndarray, after: Step) -> Step:
        self._reset(over)
        fresh = self.orchestrator.receive().step
        for stale, new in zip(after, fresh, strict=True):
            stale[over] = new
        self._note_reset(over, fresh)
        return after

    def _note_reset(self, environments: np.ndarray, fresh: Step) -> None:
        running = self._running
        running.steps[environments] = 0
        running.total_reward[environments] = 0
        for flags in (running.any, running.end, running.reset):
            flags[environments] = fresh.success
        running.parameters[environments] = self.orchestrator.parameters(environments)


def random_actions(signature: Signature, size: int, generator: np.random.Generator) -> FloatArray:
    """Uniform actions (size, action.size), for warm-up and for the floor that a random policy sets."""
    if isinstance(signature.action, Discrete):
        return generator.integers(len(signature.action.labels), size=(size, 1)).astype(np.float32)
    return generator.uniform(-1, 1, (size, signature.action.size)).astype(np.float32)
