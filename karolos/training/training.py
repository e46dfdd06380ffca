"""The training loop as a generator. It writes no files, uses no database and prints nothing.

One round: choose an action for every environment that waits for one, send the actions, learn from what the buffer
already holds while the environments step, receive the steps, store the transitions.

In lockstep a round waits for all environments. The order and the amounts depend on counts only, never on timing.
Therefore a run is the same bit for bit, however busy the machine is. An on-policy agent learns at the end of the round
that completes its rollout, because its next action depends on the update.

In async mode (`at_least`) a round waits for that many answers only. The other environments stay under way, resets
included. Learning pauses as soon as enough environments have answered, provided that the updates still owed are no
more than one step of every environment makes due. So no environment waits for the slowest one, and the replay ratio is
kept. Every episode still has the seed of its environment and index. The order of transitions and updates, and
therefore the run, depends on timing.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from ..core import Agent, Buffer, Failure, Orchestrator, State
from ..core.seeding import SeedTree
from ..errors import RunError
from ..specification.model import TrainingSettings
from .collecting import Collector
from .episodes import Episode
from .learning import Learner


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
    """Environments that failed in this round. Their episodes are cut; in lockstep those of a lost worker go on."""


@dataclass
class Training:
    """Trains one agent: `rounds()` is the loop. The caller may stop after any round, and continue from `state()`.

    Args:
        amounts: how much is collected and learned.
        seeds: the run's.
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
        self.learner = Learner(
            self.agent, self.buffer, amounts.batch_size, amounts.replay_ratio, self.orchestrator.size
        )

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
        """Whether `amounts.steps` environment steps are taken; without any, whether pre-training is over."""
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
        """The means of what `agent.learn` returned since the last call.

        Raises:
            RunError: a mean is not finite.
        """
        means = self.learner.metrics.read()
        for name, value in means.items():
            if not math.isfinite(value):
                raise RunError(
                    f"{name} is {value} after {self.updates} updates ({self.steps} steps)",
                    setting="agent",
                    hint="lower agent.learning_rate, or check the rewards; the last checkpoint is still there",
                )
        return means

    def state(self) -> State:
        """Everything that `load_state` needs to continue after any round, bit for bit in lockstep.

        Agent and buffer have states of their own. A running episode is stored as its seed and its actions, and is
        played again. In async mode the answers under way are not stored: their actions are chosen again.
        """
        return {"seconds": self.seconds, **self.collector.state(), **self.learner.state()}

    def load_state(self, state: State) -> None:
        """Continue where the state was taken, with loaded agent and buffer. Raises as `Episodes.load_state`."""
        self.collector.load_state(state)
        self.learner.load_state(state)
        self.seconds = float(state["seconds"])
