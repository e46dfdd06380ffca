"""The training loop as a generator: no files, no database, no terminal.

One round: act for the environments that wait for an action, send the actions, learn from what the buffer already holds
while the environments step, receive, store.

In lockstep a round waits for all environments. The order and the amounts depend on counts only, never on timing, so
that a run is the same bit for bit whatever the machine is busy with. An on-policy agent learns at the end of the round
that completes its rollout, because its next action depends on it.

Asynchronously (`at_least`) a round waits for so many answers and leaves the others under way, resets included; it also
breaks off learning when they have come, as long as that leaves no more updates owed than one step of every environment
is worth. So nobody waits for the slowest environment, and the replay ratio is kept. Each episode still has the seed of
its environment and index; which transitions are learned from when, and so the run, depends on timing.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..core import (
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
from ..core.schedules import Ratio
from ..core.seeding import SeedTree, generator_state, load_generator_state
from .episodes import Episode, Episodes, begun, nothing_yet, put, rows
from .progress import Amounts, Metrics, PolicyLag, Progress

UPDATES_AT_ONCE = 64
"""Of those before the first step, in a round."""


@dataclass
class Training:
    """Trains one agent. `rounds()` is the loop; the caller may stop between two rounds, and go on from `state()`.

    Args:
        at_least: answers that a round waits for; None: those of all environments (lockstep), which is the only way for
            an on-policy agent.
        updates_before: the first step: from what the buffer holds already.
    """

    orchestrator: Orchestrator
    agent: Agent[Any]
    buffer: Buffer[Any]
    amounts: Amounts
    seeds: SeedTree
    at_least: int | None = None
    updates_before: int = 0
    steps: int = 0
    episodes: int = 0
    updates: int = 0
    seconds: float = 0.0
    lag: PolicyLag = field(default_factory=PolicyLag, init=False)
    _latest: Step | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        if self.at_least is not None and (self.at_least < 1 or self.agent.on_policy):
            raise ValueError(f"a round cannot wait for {self.at_least} answers")
        size, signature = self.orchestrator.size, self.orchestrator.signature
        self._all = np.arange(size)
        self._ready = self._all
        """Environments that wait for an action."""
        self._actions = np.zeros((size, signature.action.size), np.float32)
        """What the agent said last for each environment."""
        self._running = Episodes(self.orchestrator, self.seeds)
        self._due = Ratio(self.amounts.replay_ratio / self.amounts.batch_size)
        self._owed = 0
        """Updates that are due and not made."""
        self._tolerance = math.ceil(size * self._due.ratio)
        self._heard: list[Received] = []
        """Answers that came while the agent learned."""
        self._learning_since = 0 if self._warmed_up() else None
        self._warmup = self.seeds.child("warmup").generator()

    def rounds(self) -> Iterator[Progress]:
        """Rounds until `amounts.steps` environment steps are taken."""
        while self.steps < self.amounts.steps:
            started = time.perf_counter()
            if self._latest is None and self.updates < self.updates_before:
                count = min(UPDATES_AT_ONCE, self.updates_before - self.updates)
                metrics = tuple(self._learn(self.amounts.batch_size) for _ in range(count))
                self.seconds += time.perf_counter() - started
                yield self._progress(metrics=metrics)
                continue
            if self._latest is None:
                self._latest = nothing_yet(self.orchestrator)
                self._ready = self._all[:0]
                self._begin(self._all)
                self._settle(self._latest)
            finished, metrics = self._round(self._latest)
            self.seconds += time.perf_counter() - started
            failures, self._running.failures = self._running.failures, ()
            yield self._progress(finished, metrics, failures)

    def _progress(
        self, finished: tuple[Episode, ...] = (), metrics: Metrics = (), failures: tuple[Failure, ...] = ()
    ) -> Progress:
        return Progress(
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
        """One step of the environments that are ready. Afterwards `latest` is what each was last heard to observe."""
        self._act(latest)
        metrics = () if self.agent.on_policy else self._learn_from_replay()
        self._hear(self.at_least)
        finished = self._take(latest)
        self._settle(latest)
        if self._learning_since is None and self._warmed_up():
            self._learning_since = self.steps
        return finished, self._learn_from_rollout() if self.agent.on_policy else metrics

    def _act(self, latest: Step) -> None:
        """Send an action to each environment that waits for one."""
        ready = self._ready
        if not ready.size:
            return
        signature = self.orchestrator.signature
        if self._learning_since is None:
            actions = random_actions(signature, ready.size, self._warmup)
        else:
            seen = latest.observation[ready], latest.desired_goal[ready]
            actions = self.agent.act(*seen, explore=True, environments=ready)
        self._actions[ready] = actions
        self._running.send(ready, allowed(signature, actions), updates=self.updates)
        self._ready = ready[:0]

    def _hear(self, at_least: int | None) -> int:
        """Wait for so many answers, those of this round that came before included; how many there are."""
        count = sum(received.environment.size + received.failed.size for received in self._heard)
        received = self._running.receive(None if at_least is None else max(at_least - count, 0))
        if received.environment.size or received.failures:
            self._heard.append(received)
            count += received.environment.size + received.failed.size
        return count

    def _take(self, latest: Step) -> tuple[Episode, ...]:
        """Store what was heard, and begin the episodes that follow on those that are over or lost; the former."""
        heard, self._heard = self._heard, []
        if not heard:
            return ()
        ready, over, finished = [self._ready], [], []
        for received in heard:
            fresh = begun(received)
            environments, after = rows(received, ~fresh) if fresh.any() else (received.environment, received.step)
            self._store(latest, environments, after)
            self.lag.add(self.updates - received.updates[~fresh])
            self.steps += environments.size
            put(latest, received.environment, received.step)
            ends = received.step.terminated | received.step.truncated
            ready.append(received.environment[~ends])
            over.append(received.environment[ends])
            finished += [
                self._running.record(environment, diverged=diverged)
                for environment, diverged in zip(over[-1].tolist(), received.step.diverged[ends].tolist(), strict=True)
            ]
        self.episodes += len(finished)
        failed = [received.failed for received in heard if received.failures]
        for lost in failed:
            self.buffer.cut(lost)
        self._begin(np.unique(np.concatenate((*over, *failed))))
        # An environment that has answered may have been lost since.
        self._ready = (
            np.setdiff1d(np.concatenate(ready), np.concatenate(failed)) if failed else np.sort(np.concatenate(ready))
        )
        return tuple(finished)

    def _begin(self, environments: np.ndarray) -> None:
        """Next episodes. Does not wait."""
        if environments.size:
            self._running.begin(environments)
            self.agent.begin_episodes(environments)

    def _settle(self, latest: Step) -> None:
        """In lockstep, wait until every environment has an episode; those that fail meanwhile begin another."""
        while self.at_least is None and self._ready.size < self._all.size:
            self._hear(None)
            self._take(latest)

    def _warmed_up(self) -> bool:
        return self.agent.on_policy or self.episodes >= self.amounts.warmup_episodes

    def _store(self, before: Step, environments: np.ndarray, after: Step) -> None:
        """Hand the steps that these environments took from `before` to the buffer."""
        sound = ~after.diverged  # what the simulation made of the other steps is no experience
        lost = environments[after.diverged]
        if lost.size:
            self.buffer.cut(lost)
        if not sound.any():
            return
        transitions = Transitions(
            environment=environments,
            observation=before.observation[environments],
            achieved_goal=before.achieved_goal[environments],
            desired_goal=before.desired_goal[environments],
            action=self._actions[environments],
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
        self._owed += self._due(self.steps - self._learning_since)
        metrics = []
        while self._owed > 0 and not self._called():
            metrics.append(self._learn(self.amounts.batch_size))
            self._owed -= 1
        return tuple(metrics)

    def _called(self) -> bool:
        """Whether environments have answered that learning may leave its other updates for."""
        return self.at_least is not None and self._owed <= self._tolerance and self._hear(0) >= self.at_least

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
        """All that `load_state` needs to go on between any two rounds, bit for bit in lockstep.

        Agent and buffer are stateful parts of their own and not included. A running episode is kept as its seed and its
        actions, and is played again. Asynchronously an answer that is under way is not part of it: its action is chosen
        anew.
        """
        return {
            "steps": self.steps,
            "episodes": self.episodes,
            "updates": self.updates,
            "seconds": self.seconds,
            "learning_since": self._learning_since,
            "due": self._due.counted,
            "owed": self._owed,
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
        self._owed = int(state["owed"])
        load_generator_state(self._warmup, state["warmup"])


def allowed(signature: Signature, actions: FloatArray) -> FloatArray:
    """What an environment is told when the agent says `actions`: continuous ones are cut to [-1, 1]."""
    return actions if isinstance(signature.action, Discrete) else np.clip(actions, -1, 1)
