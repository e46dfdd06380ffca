"""Training episodes: counts of the running ones, and records of those that have ended."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core import Failure, FloatArray, Orchestrator, Received, State, Step
from ..core.orchestrator import environments_of
from ..core.seeding import SeedTree
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
    """The values that domain randomization drew, laid out by `signature.parameters`."""


IDLE = -2
"""Instead of a number of updates: the environment has no command."""
REPLAYS = 3
"""Workers that may be lost in a row while the same episodes are played again."""


class Episodes:
    """The episodes that the environments of an orchestrator play one after the other, each with its own seed.

    The seed and the actions so far determine a running episode. Its state therefore needs nothing else, and a lost
    worker changes nothing: its episodes are played again up to where they were.

    Args:
        orchestrator: the environments.
        seeds: the run's; episode k of environment i has the seed at ("environment", i, k).
        replay: whether episodes of lost workers are played again, which needs lockstep. If not, they fail.
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
        """Failures since the caller last emptied this, those of episodes that were played again included."""

    def begin(self, environments: np.ndarray) -> None:
        """Reset these environments, each with the seed of its next episode. Does not wait."""
        self._index[environments] += 1
        self._seed[environments] = [
            self._seeds.child("environment", environment, int(self._index[environment])).integer()
            for environment in environments.tolist()
        ]
        self._reset(environments)

    def _reset(self, environments: np.ndarray) -> None:
        """Reset these environments with their current seeds."""
        self._steps[environments] = 0
        self._total_reward[environments] = 0
        self._updates[environments] = -1
        self._orchestrator.reset(environments, self._seed[environments].tolist())

    def send(self, environments: np.ndarray, actions: FloatArray, *, updates: int = 0) -> None:
        """Send each environment its row of `actions`, chosen after this many gradient updates. Does not wait."""
        self._actions[environments, self._steps[environments]] = actions
        self._updates[environments] = updates
        self._orchestrator.step(environments, actions, updates=updates)

    def receive(self, at_least: int | None = None) -> Received:
        """Wait for answers as `Orchestrator.receive` does, and count them. An episode that failed has no record."""
        received = self._counted(self._orchestrator.receive(at_least))
        if self._replay and any(failure.lost for failure in received.failures):
            return self._with_replayed(received)
        return received

    def _with_replayed(self, received: Received) -> Received:
        """Play the episodes of lost workers again, and add the answers to the commands that they had."""
        updates, steps = self._updates.copy(), self._steps + (self._updates >= 0)
        latest = Step.zeros(self._orchestrator.signature, self._orchestrator.size)
        failures = self._replay_lost(received.failures, steps, latest)
        latest.write(received.environment, received.step)
        answered = np.setdiff1d(np.flatnonzero(updates > IDLE), environments_of(failures))
        updates[received.environment] = received.updates
        environments = np.union1d(received.environment, answered)
        return Received(environments, latest.select(environments), updates[environments], failures)

    def _replay_lost(self, failures: tuple[Failure, ...], steps: np.ndarray, latest: Step) -> tuple[Failure, ...]:
        """Play the episodes that these failures lost with a worker again; returns the failures that remain.

        Args:
            failures: of environments whose episodes may go on.
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

    def _play_again(self, environments: np.ndarray, steps: np.ndarray, latest: Step) -> tuple[Failure, ...]:
        """Play the episodes of these environments from their seeds and actions; returns the failures. See above."""
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
        self.failures += received.failures
        self._updates[received.environment] = IDLE
        reset = received.updates < 0
        if reset.any():
            environments = received.environment[reset]
            for flags in (self._any, self._end, self._reset_success):
                flags[environments] = received.step.success[reset]
            self._parameters[environments] = self._orchestrator.parameters(environments)
        stepped = received.select(~reset)
        self._count(stepped.environment, stepped.step)
        return received

    def _count(self, environments: np.ndarray, step: Step) -> None:
        self._steps[environments] += 1
        self._total_reward[environments] += step.reward
        self._any[environments] |= step.success
        self._end[environments] = step.success

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
        """Play the running episodes again up to where they were, and write their latest steps into `latest`.

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
