"""The training loop as a generator. It writes no files, uses no database and prints nothing.

One round: choose an action for every environment that waits for one, send the actions, learn from what the buffer
already holds while the environments step, receive the steps, store the transitions.

In lockstep a round waits for all environments. Order and amounts depend only on counts, never on timing. Therefore a
run is the same bit for bit, even on a busy machine. An on-policy agent learns at the end of the round that completes
its rollout, because its next action depends on the update.

In async mode (`at_least`) a round waits only for that number of answers. The other environments continue their steps
and resets. Learning pauses as soon as enough environments have answered, if the pending updates are at most those that
one step of every environment makes due. Thus no environment waits for the slowest one, and the replay ratio is kept.
Every episode still has the seed of its environment and index. The order of transitions and updates, and therefore the
run, depends on timing.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..core import Agent, Buffer, Failure, Orchestrator, SeedTree, State
from ..core.schedules import Ratio
from ..errors import RunError
from ..specification.model import TrainingSettings
from .collecting import Collector, Episode


@dataclass(frozen=True)
class Progress:
    """The state of training after a round."""

    steps: int
    episodes: int
    updates: int
    seconds: float
    """Wall-clock seconds of collecting and learning; the caller may add those of demonstrations."""
    warming_up: bool
    """Whether actions are still random."""
    finished: tuple[Episode, ...] = ()
    """Episodes that ended in this round."""
    failures: tuple[Failure, ...] = ()
    """Environments that failed in this round. Their episodes are cut; in lockstep those of a lost worker continue."""


@dataclass
class Training:
    """Trains one agent: `rounds()` is the loop. The caller may stop after any round, and continue from `state()`.

    Args:
        at_least: answers that a round waits for; None waits for all environments (lockstep). An on-policy agent needs
            lockstep.
        pretraining_updates: gradient updates on the demonstrations before the first environment step.
    """

    orchestrator: Orchestrator
    agent: Agent[Any]
    buffer: Buffer[Any]
    amounts: TrainingSettings
    seeds: SeedTree
    at_least: int | None = None
    pretraining_updates: int = 0
    seconds: float = field(default=0.0, init=False)
    collector: Collector = field(init=False)
    learner: Learner = field(init=False)

    def __post_init__(self) -> None:
        if self.at_least is not None and (self.at_least < 1 or self.agent.on_policy):
            raise ValueError(f"a round cannot wait for {self.at_least} answers")
        amounts = self.amounts
        self.collector = Collector(
            self.orchestrator, self.agent, self.buffer, self.seeds, amounts.warmup_episodes, self.at_least
        )
        self.learner = Learner(self.agent, self.buffer, amounts, self.orchestrator.size)

    def rounds(self) -> Iterator[Progress]:
        """Rounds until training is over."""
        while not self.over:
            finished: tuple[Episode, ...] = ()
            failures: tuple[Failure, ...] = ()
            started = time.perf_counter()
            if not self.collector.started and self.updates < self.pretraining_updates:
                self.learner.pretrain(self.pretraining_updates)
            else:
                finished, failures = self._round()
            self.seconds += time.perf_counter() - started
            yield Progress(
                steps=self.steps,
                episodes=self.episodes,
                updates=self.updates,
                seconds=self.seconds,
                warming_up=self.collector.warming_up,
                finished=finished,
                failures=failures,
            )

    def _round(self) -> tuple[tuple[Episode, ...], tuple[Failure, ...]]:
        """One step of the environments that wait for an action, and the updates that are due."""
        collector, learner = self.collector, self.learner
        collector.start()
        collector.act(learner.updates)
        if not self.agent.on_policy and not collector.warming_up:
            learner.learn_from_replay(collector.steps_since_warmup, collector.enough_answered)
        finished, failures = collector.collect(learner.updates)
        if self.agent.on_policy:
            learner.learn_from_rollout()
        return finished, failures

    @property
    def over(self) -> bool:
        """Whether `amounts.steps` environment steps are done; if it is 0, whether pre-training is over."""
        pretrained = self.collector.started or self.updates >= self.pretraining_updates
        return self.steps >= self.amounts.steps and pretrained

    @property
    def steps(self) -> int:
        return self.collector.steps

    @property
    def episodes(self) -> int:
        return self.collector.episodes

    @property
    def updates(self) -> int:
        return self.learner.updates

    def totals(self) -> dict[str, Any]:
        """Steps, updates and seconds so far, by these names."""
        return {"steps": self.steps, "updates": self.updates, "seconds": self.seconds}

    def read_metrics(self) -> dict[str, float]:
        """Means of the results of `agent.learn` since the last call.

        Raises:
            RunError: a mean is not finite.
        """
        means = self.learner.metrics.read()
        for name, value in means.items():
            if not math.isfinite(value):
                raise RunError(
                    f"{name} is {value} after {self.updates} updates ({self.steps} steps)",
                    setting="agent",
                    hint="lower agent.learning_rate, or check the rewards; the last checkpoint is kept",
                )
        return means

    def state(self) -> State:
        """Everything that `load_state` needs to continue after any round, bit for bit in lockstep.

        Agent and buffer have states of their own. A running episode is stored as its seed and actions, and is played
        again. In async mode pending answers are not stored: their actions are chosen again.
        """
        return {"seconds": self.seconds, **self.collector.state(), **self.learner.state()}

    def load_state(self, state: State) -> None:
        """Continue from the state, with loaded agent and buffer. Raises as `Episodes.load_state`."""
        self.collector.load_state(state)
        self.learner.load_state(state)
        self.seconds = float(state["seconds"])


PRETRAINING_UPDATES_PER_ROUND = 64


class Means:
    """Running means of named scalars. It adds tensors without reading them; only `read` reads their numbers."""

    def __init__(self) -> None:
        self._sums: dict[str, Any] = {}
        self._counts: dict[str, int] = {}

    def add(self, values: Mapping[str, Any]) -> None:
        for name, value in values.items():
            self._sums[name] = self._sums[name] + value if name in self._sums else value
            self._counts[name] = self._counts.get(name, 0) + 1

    def read(self) -> dict[str, float]:
        """The means since the last call."""
        means = {name: float(total) / self._counts[name] for name, total in self._sums.items()}
        self._sums.clear()
        self._counts.clear()
        return means


class Learner:
    """Decides when the agent learns, and from which batch.

    With a replay buffer, `replay_ratio / batch_size` updates are due for each environment step since warm-up ended.
    With an on-policy buffer, the agent learns once from each complete rollout.

    Args:
        environments: number of environments, which limits the updates that may wait in async mode.
    """

    def __init__(self, agent: Agent[Any], buffer: Buffer[Any], amounts: TrainingSettings, environments: int) -> None:
        self._agent, self._buffer, self._batch_size = agent, buffer, amounts.batch_size
        self._due = Ratio(amounts.replay_ratio / amounts.batch_size)
        self._owed = 0
        """Updates that are due and not made yet."""
        self._may_wait = math.ceil(environments * self._due.ratio)
        self.updates = 0
        self.metrics = Means()
        """Results of `agent.learn`."""

    def pretrain(self, updates: int) -> None:
        """Make some updates before the first environment step, in each call until the total is `updates`."""
        for _ in range(min(PRETRAINING_UPDATES_PER_ROUND, updates - self.updates)):
            self._learn(self._batch_size)

    def learn_from_replay(self, steps: int, interrupted: Callable[[], bool]) -> None:
        """Make the updates that are due.

        Args:
            steps: environment steps since warm-up ended.
            interrupted: whether the updates that may wait are left for a later call.
        """
        self._owed += self._due(steps)
        if self._owed and not len(self._buffer):  # every episode so far has diverged
            return
        while self._owed > 0 and not (self._owed <= self._may_wait and interrupted()):
            self._learn(self._batch_size)
            self._owed -= 1

    def learn_from_rollout(self) -> None:
        """Learn from the rollout if it is complete."""
        size = len(self._buffer)
        if size:
            self._learn(size)

    def _learn(self, size: int) -> None:
        batch = self._buffer.sample(size)
        metrics = dict(self._agent.learn(batch))
        self.updates += metrics.pop("updates", 1)
        priorities = metrics.pop("priorities", None)
        if priorities is not None:
            self._buffer.update_priorities(batch.slot, priorities)
        self.metrics.add(metrics)

    def state(self) -> State:
        return {"updates": self.updates, "due": self._due.counted, "owed": self._owed}

    def load_state(self, state: State) -> None:
        self.updates, self._due.counted, self._owed = (
            int(np.int64(state[name])) for name in ("updates", "due", "owed")
        )
