"""Collecting: lets the environments play training episodes and stores the transitions."""

from __future__ import annotations

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
from ..core.seeding import SeedTree, generator_state, load_generator_state
from .episodes import Episode, Episodes


class Collector:
    """Steps the environments with the agent's actions and stores the transitions in the buffer.

    A round calls `act`, which does not wait, and then `collect`. Actions are uniformly random during warm-up.

    Args:
        orchestrator: the environments.
        agent: chooses the actions; an on-policy agent has no warm-up.
        buffer: stores the transitions.
        seeds: the run's.
        warmup_episodes: episodes that end before the agent acts and learns.
        at_least: answers that `collect` waits for; None waits for all environments (lockstep).
    """

    def __init__(
        self,
        orchestrator: Orchestrator,
        agent: Agent[Any],
        buffer: Buffer[Any],
        seeds: SeedTree,
        warmup_episodes: int,
        at_least: int | None = None,
    ) -> None:
        self._orchestrator, self._agent, self._buffer = orchestrator, agent, buffer
        self._warmup_episodes, self._at_least = warmup_episodes, at_least
        size, signature = orchestrator.size, orchestrator.signature
        self.started = False
        """Whether the environments have begun their first episodes."""
        self.steps = self.episodes = 0
        self.strayed: tuple[int, ...] = ()
        """Environments whose episodes, played again by `load_state`, gave another observation than they had."""
        self._running = Episodes(orchestrator, seeds, replay=at_least is None)
        self._latest = Step.zeros(signature, size)
        """The latest step of every environment."""
        self._all = np.arange(size)
        self._ready = self._all
        """Environments that wait for an action."""
        self._actions = np.zeros((size, signature.action.size), np.float32)
        """The agent's latest action for each environment."""
        self._received: list[Received] = []
        """Answers that are not stored yet."""
        self._lags: list[np.ndarray] = []
        self._warmup = seeds.child("warmup").generator()
        self._learning_since = 0 if self._warmed_up() else None

    @property
    def warming_up(self) -> bool:
        return self._learning_since is None

    @property
    def steps_since_warmup(self) -> int:
        return 0 if self._learning_since is None else self.steps - self._learning_since

    def start(self) -> None:
        """Begin the first episode of every environment, unless the episodes are running already."""
        if not self.started:
            self.started = True
            self._ready = self._all[:0]
            self._begin(self._all)
            self._wait_for_episodes(updates=0)

    def act(self, updates: int) -> None:
        """Send an action to each environment that waits for one; `updates` is the number of updates made so far."""
        ready = self._ready
        if not ready.size:
            return
        signature = self._orchestrator.signature
        if self.warming_up:
            actions = random_actions(signature, ready.size, self._warmup)
        else:
            observation, desired_goal = self._latest.observation[ready], self._latest.desired_goal[ready]
            actions = self._agent.act(observation, desired_goal, explore=True, environments=ready)
        self._actions[ready] = actions
        self._running.send(ready, clipped(signature, actions), updates=updates)
        self._ready = ready[:0]

    def enough_answered(self) -> bool:
        """Whether `collect` would return without waiting; always False in lockstep."""
        return self._at_least is not None and self._receive(0) >= self._at_least

    def collect(self, updates: int) -> tuple[tuple[Episode, ...], tuple[Failure, ...]]:
        """Wait for answers, store the transitions and begin the next episodes.

        Returns the episodes that have ended, and the failures since the last call.
        """
        self._receive(self._at_least)
        finished = self._store_received(updates)
        self._wait_for_episodes(updates)
        if self._learning_since is None and self._warmed_up():
            self._learning_since = self.steps
        failures, self._running.failures = self._running.failures, ()
        return finished, failures

    def read_policy_lag(self) -> dict[str, float]:
        """Mean and maximum, since the last call, of the updates between choosing an action and storing its transition.

        Empty if no transition was stored.
        """
        lags, self._lags = np.concatenate([np.zeros(0, np.int64), *self._lags]), []
        return {"policy_lag_mean": float(lags.mean()), "policy_lag_max": int(lags.max())} if lags.size else {}

    def _receive(self, at_least: int | None) -> int:
        """Wait until this many environments have answered since answers were last stored; returns how many have."""
        count = sum(received.environment.size + received.failed.size for received in self._received)
        received = self._running.receive(None if at_least is None else max(at_least - count, 0))
        if received.environment.size or received.failures:
            self._received.append(received)
            count += received.environment.size + received.failed.size
        return count

    def _store_received(self, updates: int) -> tuple[Episode, ...]:
        """Store the answers and begin the next episodes; returns the episodes that have ended."""
        answers, self._received = self._received, []
        if not answers:
            return ()
        ready, over, finished = [self._ready], [], []
        for received in answers:
            stepped = received.select(received.updates >= 0)  # the other answers are to a reset
            self._store(stepped.environment, stepped.step)
            self._lags.append(updates - stepped.updates)
            self.steps += stepped.environment.size
            self._latest.write(received.environment, received.step)
            ends = received.step.terminated | received.step.truncated
            ready.append(received.environment[~ends])
            over.append(received.environment[ends])
            finished += [
                self._running.record(environment, diverged=diverged)
                for environment, diverged in zip(over[-1].tolist(), received.step.diverged[ends].tolist(), strict=True)
            ]
        self.episodes += len(finished)
        failed = [received.failed for received in answers if received.failures]
        for environments in failed:
            self._buffer.cut(environments)
        self._begin(np.unique(np.concatenate((*over, *failed))))
        # An environment that has answered may have failed since.
        self._ready = (
            np.setdiff1d(np.concatenate(ready), np.concatenate(failed)) if failed else np.sort(np.concatenate(ready))
        )
        return tuple(finished)

    def _begin(self, environments: np.ndarray) -> None:
        """Begin the next episode of these environments. Does not wait."""
        if environments.size:
            self._running.begin(environments)
            self._agent.begin_episodes(environments)

    def _wait_for_episodes(self, updates: int) -> None:
        """In lockstep, wait until every environment has an episode. An environment that fails begins another one."""
        while self._at_least is None and self._ready.size < self._all.size:
            self._receive(None)
            self._store_received(updates)

    def _warmed_up(self) -> bool:
        return self._agent.on_policy or self.episodes >= self._warmup_episodes

    def _store(self, environments: np.ndarray, step: Step) -> None:
        """Store the transitions of these environments from their latest step to this one, unless they diverged."""
        valid, latest = ~step.diverged, self._latest
        diverged = environments[step.diverged]
        if diverged.size:
            self._buffer.cut(diverged)
        if not valid.any():
            return
        transitions = Transitions(
            environment=environments,
            observation=latest.observation[environments],
            achieved_goal=latest.achieved_goal[environments],
            desired_goal=latest.desired_goal[environments],
            action=self._actions[environments],
            reward=step.reward,
            next_observation=step.observation,
            next_achieved_goal=step.achieved_goal,
            terminated=step.terminated,
            truncated=step.truncated,
        )
        self._buffer.add(transitions if valid.all() else Transitions(*(field[valid] for field in transitions)))

    def state(self) -> State:
        return {
            "steps": self.steps,
            "episodes": self.episodes,
            "learning_since": self._learning_since,
            "warmup": generator_state(self._warmup),
            "running": self._running.state() if self.started else None,
            "observation": self._latest.observation.copy(),
        }

    def load_state(self, state: State) -> None:
        """Play the running episodes again up to where they were. Raises as `Episodes.load_state`."""
        if state["running"] is not None:
            self._running.load_state(state["running"], self._latest)
            self.started = True
            if self._at_least is None:  # in async mode an episode may have begun without an observation
                now, then = self._latest.observation, np.asarray(state["observation"])
                same = (now == then) | (np.isnan(now) & np.isnan(then))
                self.strayed = tuple(np.flatnonzero(~same.all(1)).tolist())
        self.steps, self.episodes = (int(np.int64(state[name])) for name in ("steps", "episodes"))
        since = state["learning_since"]
        self._learning_since = None if since is None else int(np.int64(since))
        load_generator_state(self._warmup, state["warmup"])


def clipped(signature: Signature, actions: FloatArray) -> FloatArray:
    """The actions as the environments take them: continuous ones are clipped to [-1, 1]."""
    return actions if isinstance(signature.action, Discrete) else np.clip(actions, -1, 1)
