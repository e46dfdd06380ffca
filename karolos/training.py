"""The training loop as a generator: no files, no database, no terminal.

One round, in lockstep: act for all environments, send the actions, learn from what the buffer already holds while the
environments step, receive, store. An on-policy agent learns at the end of the round that completes its rollout, because
its next action depends on it. The order and the amounts depend on counts only, never on timing, so that a run is the
same bit for bit whatever the machine is busy with.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from .core import (
    Agent,
    Buffer,
    Discrete,
    Failure,
    FloatArray,
    Orchestrator,
    Received,
    Signature,
    State,
    Step,
    Transitions,
    random_actions,
)
from .episodes import Episode, Episodes, nothing_yet, put
from .schedules import Ratio
from .seeding import SeedTree, generator_state, load_generator_state

Metrics = tuple[Mapping[str, Any], ...]
NOBODY = np.zeros(0, np.int64)


class Amounts(Protocol):
    """How much to train (spec key `training`). An on-policy agent is told by its own settings all but the steps."""

    @property
    def steps(self) -> int: ...
    @property
    def batch_size(self) -> int: ...
    @property
    def replay_ratio(self) -> float: ...
    @property
    def warmup_episodes(self) -> int: ...


@dataclass(frozen=True)
class Progress:
    """Where training stands after a round."""

    steps: int
    episodes: int
    updates: int
    seconds: float
    """Wall-clock seconds of collecting and learning; what the caller does between rounds is not counted."""
    warming_up: bool
    """Whether actions are still drawn at random."""
    finished: tuple[Episode, ...] = ()
    metrics: Metrics = ()
    """What `agent.learn` returned each time in this round."""
    failures: tuple[Failure, ...] = ()
    """Environments that failed in this round; they have begun other episodes since."""


@dataclass
class Training:
    """Trains one agent. `rounds()` is the loop; the caller may stop between two rounds, and go on from `state()`."""

    orchestrator: Orchestrator
    agent: Agent[Any]
    buffer: Buffer[Any]
    amounts: Amounts
    seeds: SeedTree
    steps: int = 0
    episodes: int = 0
    updates: int = 0
    seconds: float = 0.0
    _latest: Step | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self._all = np.arange(self.orchestrator.size)
        self._running = Episodes(self.orchestrator, self.seeds)
        self._due = Ratio(self.amounts.replay_ratio / self.amounts.batch_size)
        self._learning_since = 0 if self._warmed_up() else None
        self._warmup = self.seeds.child("warmup").generator()

    def rounds(self) -> Iterator[Progress]:
        """Rounds until `amounts.steps` environment steps are taken."""
        while self.steps < self.amounts.steps:
            started = time.perf_counter()
            if self._latest is None:
                self._latest = nothing_yet(self.orchestrator)
                self._begin(self._all, self._latest)
            finished, metrics = self._round(self._latest)
            self.seconds += time.perf_counter() - started
            failures, self._running.failures = self._running.failures, ()
            yield Progress(
                steps=self.steps,
                episodes=self.episodes,
                updates=self.updates,
                seconds=self.seconds,
                warming_up=self._learning_since is None,
                finished=finished,
                metrics=metrics,
                failures=failures,
            )

    def _round(self, latest: Step) -> tuple[tuple[Episode, ...], Metrics]:
        """One step of every environment. Afterwards `latest` is what the environments observe now."""
        actions = self._act(latest)
        self._running.send(self._all, allowed(self.orchestrator.signature, actions), updates=self.updates)
        metrics = () if self.agent.on_policy else self._learn_from_replay()
        received = self._running.receive()
        environments, after = received.environment, received.step
        failed = received.failed if received.failures else NOBODY
        self._store(latest, actions, received, failed)
        put(latest, environments, after)
        self.steps += environments.size
        ends = after.terminated | after.truncated
        over = environments[ends]
        finished = tuple(
            self._running.record(environment, diverged=diverged)
            for environment, diverged in zip(over.tolist(), after.diverged[ends].tolist(), strict=True)
        )
        self.episodes += len(finished)
        self._begin(np.concatenate((over, failed)), latest)
        if self._learning_since is None and self._warmed_up():
            self._learning_since = self.steps
        return finished, self._learn_from_rollout() if self.agent.on_policy else metrics

    def _begin(self, environments: np.ndarray, latest: Step) -> None:
        """Next episodes. Environments that fail meanwhile lose the ones that they were amid."""
        if not environments.size:
            return
        before = len(self._running.failures)
        self._running.begin(environments, latest)
        lost = [failure.environment for failure in self._running.failures[before:]]
        for failed in lost:
            self.buffer.cut(failed)
        self.agent.begin_episodes(np.unique(np.concatenate((environments, *lost))) if lost else environments)

    def _warmed_up(self) -> bool:
        return self.agent.on_policy or self.episodes >= self.amounts.warmup_episodes

    def _act(self, before: Step) -> FloatArray:
        if self._learning_since is None:
            return random_actions(self.orchestrator.signature, self._all.size, self._warmup)
        return self.agent.act(before.observation, before.desired_goal, explore=True)

    def _store(self, before: Step, actions: FloatArray, received: Received, failed: np.ndarray) -> None:
        environments, after = received.environment, received.step
        sound = ~after.diverged  # what the simulation made of the other steps is no experience
        lost = np.concatenate((environments[after.diverged], failed))
        if lost.size:
            self.buffer.cut(lost)
        if not sound.any():
            return
        transitions = Transitions(
            environment=environments,
            observation=before.observation[environments],
            achieved_goal=before.achieved_goal[environments],
            desired_goal=before.desired_goal[environments],
            action=actions[environments],
            reward=after.reward,
            next_observation=after.observation,
            next_achieved_goal=after.achieved_goal,
            terminated=after.terminated,
            truncated=after.truncated,
        )
        self.buffer.add(transitions if sound.all() else Transitions(*(field[sound] for field in transitions)))

    def _learn_from_replay(self) -> Metrics:
        """The updates that are due: the replay ratio counts the steps since warm-up ended."""
        if self._learning_since is None:
            return ()
        due = self._due(self.steps - self._learning_since)
        return tuple(self._learn(self.amounts.batch_size) for _ in range(due))

    def _learn_from_rollout(self) -> Metrics:
        """All that the rollout is good for, once it is complete."""
        size = len(self.buffer)
        return (self._learn(size),) if size else ()

    def _learn(self, size: int) -> Mapping[str, Any]:
        batch = self.buffer.sample(size)
        metrics = dict(self.agent.learn(batch))
        self.updates += metrics.pop("updates", 1)
        priorities = metrics.pop("priorities", None)
        if priorities is not None:
            self.buffer.update_priorities(batch.slot, priorities)
        return metrics

    def state(self) -> State:
        """All that `load_state` needs to go on bit for bit, between any two rounds.

        Agent and buffer are stateful parts of their own and not included. A running episode is kept as its seed and its
        actions, and is played again.
        """
        return {
            "steps": self.steps,
            "episodes": self.episodes,
            "updates": self.updates,
            "seconds": self.seconds,
            "learning_since": self._learning_since,
            "due": self._due.counted,
            "warmup": generator_state(self._warmup),
            "running": None if self._latest is None else self._running.state(),
        }

    def load_state(self, state: State) -> None:
        """Go on where the state was taken; agent and buffer have to be loaded beside it.

        Raises:
            UsageError: the state is of another number of environments, or of environments with other actions.
        """
        running = state["running"]
        if running is not None:
            self._latest = nothing_yet(self.orchestrator)
            self._running.load_state(running, self._latest)
        self.steps, self.episodes, self.updates = (int(state[name]) for name in ("steps", "episodes", "updates"))
        self.seconds = float(state["seconds"])
        self._learning_since = state["learning_since"]
        self._due.counted = int(state["due"])
        load_generator_state(self._warmup, state["warmup"])


def allowed(signature: Signature, actions: FloatArray) -> FloatArray:
    """What an environment is told when the agent says `actions`: continuous ones are cut to [-1, 1]."""
    return actions if isinstance(signature.action, Discrete) else np.clip(actions, -1, 1)
