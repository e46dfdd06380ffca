"""Collecting: plays training episodes, counts and records them, and stores the transitions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core import (
    Agent,
    Buffer,
    Discrete,
    Failure,
    FloatArray,
    Orchestrator,
    Received,
    SeedTree,
    Signature,
    State,
    Step,
    Transitions,
    generator_state,
    load_generator_state,
    random_actions,
)
from ..core.orchestrator import environments_of
from ..errors import UsageError


@dataclass(frozen=True)
class Episode:
    """The record of one training episode; `any`, `end` and `reset` as in a test."""

    environment: int
    index: int
    """Position among this environment's episodes, from 0."""
    seed: int
    steps: int
    total_reward: float
    any: bool
    end: bool
    reset: bool
    diverged: bool
    """Whether the simulation diverged, which ended the episode."""
    parameters: tuple[float, ...]
    """The sampled values of domain randomization, in the layout `signature.parameters`."""


IDLE = -2
"""Marks an environment without a command, in place of a number of updates."""
REPLAYS = 3
"""Largest number of workers lost in a row while the same episodes are played again."""


class Episodes:
    """The episodes that the environments of an orchestrator play one after the other, each with its own seed.

    The seed and the actions so far determine a running episode. Its state therefore needs nothing else, and a lost
    worker changes nothing: its episodes are played again up to the same step.

    Args:
        seeds: the run's; episode k of environment i has the seed at ("environment", i, k).
        replay: whether episodes of lost workers are played again, which needs lockstep. Otherwise they fail.
    """

    def __init__(self, orchestrator: Orchestrator, seeds: SeedTree, *, replay: bool = True) -> None:
        self._orchestrator, self._seeds, self._replay = orchestrator, seeds, replay
        size, signature = orchestrator.size, orchestrator.signature
        self._index = np.full(size, -1)
        self._seed = np.zeros(size, np.int64)
        self._steps = np.zeros(size, np.int64)
        self._total_reward = np.zeros(size)
        self._any = np.zeros(size, np.bool_)
        self._end = np.zeros(size, np.bool_)
        self._reset_success = np.zeros(size, np.bool_)
        self._parameters = np.zeros((size, signature.parameters.size), np.float32)
        self._actions = np.zeros((size, signature.max_steps, signature.action.size), np.float32)
        """The actions of each running episode; entries beyond its steps belong to older episodes."""
        self._updates = np.full(size, IDLE)
        """`updates` of each environment's command without an answer; -1 for a reset, or IDLE."""
        self.failures: tuple[Failure, ...] = ()
        """Failures since the caller last emptied this list, including those of episodes that were played again."""

    def begin(self, environments: NDArray[np.int64]) -> None:
        """Reset these environments, each with the seed of its next episode. Does not wait."""
        self._index[environments] += 1
        self._seed[environments] = [
            self._seeds.child("environment", environment, int(self._index[environment])).integer()
            for environment in environments.tolist()
        ]
        self._reset(environments)

    def _reset(self, environments: NDArray[np.int64]) -> None:
        """Reset these environments with their current seeds."""
        self._steps[environments] = 0
        self._total_reward[environments] = 0
        self._updates[environments] = -1
        self._orchestrator.reset(environments, self._seed[environments].tolist())

    def send(self, environments: NDArray[np.int64], actions: FloatArray, *, updates: int = 0) -> None:
        """Send each environment its row of `actions`, chosen after this many gradient updates. Does not wait."""
        self._actions[environments, self._steps[environments]] = actions
        self._updates[environments] = updates
        self._orchestrator.step(environments, actions, updates=updates)

    def receive(self, at_least: int | None = None) -> Received:
        """Wait for answers as `Orchestrator.receive` does, and count them. An episode that failed has no record."""
        received = self._counted(self._orchestrator.receive(at_least))
        if not (self._replay and any(failure.lost for failure in received.failures)):
            return received
        # Play the episodes of lost workers again, and add the answers to their pending commands.
        updates, steps = self._updates.copy(), self._steps + (self._updates >= 0)
        latest = Step.zeros(self._orchestrator.signature, self._orchestrator.size)
        failures = self._replay_lost(received.failures, steps, latest)
        latest.write(received.environment, received.step)
        answered = np.setdiff1d(np.flatnonzero(updates > IDLE), environments_of(failures))
        updates[received.environment] = received.updates
        environments = np.union1d(received.environment, answered)
        return Received(environments, latest.select(environments), updates[environments], failures)

    def _replay_lost(
        self, failures: tuple[Failure, ...], steps: NDArray[np.int64], latest: Step
    ) -> tuple[Failure, ...]:
        """Play the episodes that these failures lost with a worker again; returns the failures that remain.

        Args:
            failures: of environments whose episodes may continue.
            steps: of the episode of each environment.
            latest: is overwritten by the last step of each of these environments.
        """
        for _ in range(REPLAYS):
            remaining = tuple(failure for failure in failures if not failure.lost)
            lost = np.setdiff1d(environments_of(failures), environments_of(remaining))
            if not lost.size:
                return remaining
            failures = remaining + self._play_again(lost, steps, latest)
        return failures

    def _play_again(
        self, environments: NDArray[np.int64], steps: NDArray[np.int64], latest: Step
    ) -> tuple[Failure, ...]:
        """Play the episodes of these environments from their seeds and actions; returns the failures.

        Arguments `steps` and `latest` are those of `_replay_lost`.
        """
        failures: tuple[Failure, ...] = ()
        self._reset(environments)
        for step in range(int(steps[environments].max()) + 1):
            received = self._counted(self._orchestrator.receive())
            latest.write(received.environment, received.step)
            failures += received.failures
            playing = np.setdiff1d(environments[steps[environments] > step], environments_of(failures))
            if playing.size:
                self.send(playing, self._actions[playing, step])
        return failures

    def _counted(self, received: Received) -> Received:
        """Add the answers and failures to the records of the episodes; returns the same."""
        self.failures += received.failures
        self._updates[received.environment] = IDLE
        reset = received.updates < 0
        if reset.any():
            environments = received.environment[reset]
            for flags in (self._any, self._end, self._reset_success):
                flags[environments] = received.step.success[reset]
            self._parameters[environments] = self._orchestrator.parameters(environments)
        stepped = received.select(~reset)
        environments, step = stepped.environment, stepped.step
        self._steps[environments] += 1
        self._total_reward[environments] += step.reward
        self._any[environments] |= step.success
        self._end[environments] = step.success
        return received

    def record(self, environment: int, *, diverged: bool) -> Episode:
        """The record of the episode that this environment has just ended."""
        return Episode(
            environment=environment,
            index=int(self._index[environment]),
            seed=int(self._seed[environment]),
            steps=int(self._steps[environment]),
            total_reward=float(self._total_reward[environment]),
            any=bool(self._any[environment]),
            end=bool(self._end[environment]),
            reset=bool(self._reset_success[environment]),
            diverged=diverged,
            parameters=tuple(self._parameters[environment].tolist()),
        )

    def state(self) -> State:
        """Seeds and actions of the running episodes, as copies."""
        longest = int(self._steps.max())
        return {
            "index": self._index.copy(),
            "seed": self._seed.copy(),
            "steps": self._steps.copy(),
            "actions": self._actions[:, :longest].copy(),
        }

    def load_state(self, state: State, latest: Step) -> None:
        """Play the running episodes again up to the same step, and write their latest steps into `latest`.

        Raises:
            UsageError: the state has another number of environments or of action columns.
            KarolosError: an environment failed.
        """
        index, actions = np.asarray(state["index"]), np.asarray(state["actions"])
        longest = actions.shape[1]
        if index.shape != self._index.shape or actions.shape != self._actions[:, :longest].shape:
            raise UsageError(
                f"the stored run has {len(index)} environments with {actions.shape[-1]} action columns,"
                f" and this one {len(self._index)} with {self._actions.shape[-1]}",
                setting="orchestrator",
                hint="resume with the spec that the run was started with",
            )
        self._index[:] = index
        self._seed[:] = state["seed"]
        self._actions[:, :longest] = actions
        steps = np.asarray(state["steps"])
        failures = self._play_again(np.arange(len(index)), steps, latest)
        if self._replay:
            failures = self._replay_lost(failures, steps, latest)
        if failures:
            raise failures[0].error


class Collector:
    """Steps the environments with the agent's actions and stores the transitions in the buffer.

    A round calls `act`, which does not wait, and then `collect`. Actions are uniformly random during warm-up.

    Args:
        agent: chooses the actions; an on-policy agent has no warm-up.
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
        """Environments whose episodes, played again by `load_state`, gave a different observation."""
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
        self._lags: list[NDArray[np.int64]] = []
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
        """Wait until this number of environments has answered since answers were last stored. Returns the number."""
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
        self._ready = np.sort(np.concatenate(ready))
        if failed:  # an environment that has answered may have failed since
            self._ready = np.setdiff1d(self._ready, np.concatenate(failed))
        return tuple(finished)

    def _begin(self, environments: NDArray[np.int64]) -> None:
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

    def _store(self, environments: NDArray[np.int64], step: Step) -> None:
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
        """Play the running episodes again up to the same step. Raises as `Episodes.load_state`."""
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
