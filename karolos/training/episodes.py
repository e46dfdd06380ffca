"""Training episodes: counts of the running ones, and records of those that have ended."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..core import Failure, FloatArray, Orchestrator, Received, State, Step
from ..core.seeding import SeedTree
from ..errors import PluginError, UsageError


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


class Episodes:
    """The episodes that the environments of an orchestrator play one after the other, each with its own seed.

    The seed and the actions so far determine a running episode. Its state therefore needs nothing else.

    Args:
        orchestrator: the environments.
        seeds: the run's; episode k of environment i has the seed at ("environment", i, k).
    """

    def __init__(self, orchestrator: Orchestrator, seeds: SeedTree) -> None:
        self._orchestrator, self._seeds = orchestrator, seeds
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
        self.failures: tuple[Failure, ...] = ()
        """Failures since the caller last emptied this. An episode that failed has no record."""

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
        self._orchestrator.reset(environments, self._seed[environments].tolist())

    def send(self, environments: np.ndarray, actions: FloatArray, *, updates: int = 0) -> None:
        """Send each environment its row of `actions`, chosen after this many gradient updates. Does not wait."""
        self._actions[environments, self._steps[environments]] = actions
        self._orchestrator.step(environments, actions, updates=updates)

    def receive(self, at_least: int | None = None) -> Received:
        """Wait for answers as `Orchestrator.receive` does, and count them.

        Raises:
            PluginError: a reward is not finite.
        """
        received = self._orchestrator.receive(at_least)
        self.failures += received.failures
        reset = received.updates < 0
        if reset.any():
            environments = received.environment[reset]
            for flags in (self._any, self._end, self._reset_success):
                flags[environments] = received.step.success[reset]
            self._parameters[environments] = self._orchestrator.parameters(environments)
        self._count(*select_rows(received, ~reset))
        return received

    def _count(self, environments: np.ndarray, step: Step) -> None:
        if not math.isfinite(step.reward.sum()) and not np.isfinite(step.reward).all():  # a sum is cheaper
            first = int(np.flatnonzero(~np.isfinite(step.reward))[0])
            raise PluginError(
                f"the environment gave the reward {step.reward[first]} after step"
                f" {self._steps[environments[first]] + 1} of an episode",
                where=f"environment {environments[first]}",
                hint="a reward is a finite number: check how the environment or the task computes it",
            )
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
                where="orchestrator",
                hint="resume with the spec that the run was started with",
            )
        self._index[:] = index
        self._seed[:] = state["seed"]
        steps = np.asarray(state["steps"])
        self._reset(np.arange(len(index)))
        for step in range(longest + 1):
            received = self.receive()
            write_rows(latest, received.environment, received.step)
            playing = np.flatnonzero(steps > step)
            if playing.size:
                self.send(playing, actions[playing, step])
        if self.failures:
            raise self.failures[0].error


def empty_steps(orchestrator: Orchestrator) -> Step:
    """A step of zeros for every environment, to be overwritten by `write_rows`."""
    size, signature = orchestrator.size, orchestrator.signature

    def zeros(columns: int) -> FloatArray:
        return np.zeros((size, columns), np.float32)

    return Step(
        observation=zeros(signature.observation.size),
        achieved_goal=zeros(signature.achieved_goal.size),
        desired_goal=zeros(signature.desired_goal.size),
        reward=np.zeros(size, np.float32),
        terminated=np.zeros(size, np.bool_),
        truncated=np.zeros(size, np.bool_),
        success=np.zeros(size, np.bool_),
        diverged=np.zeros(size, np.bool_),
    )


def write_rows(steps: Step, environments: np.ndarray, rows: Step) -> None:
    """Overwrite the rows of these environments in `steps`."""
    for field, new in zip(steps, rows, strict=True):
        field[environments] = new


def select_rows(received: Received, which: np.ndarray) -> tuple[np.ndarray, Step]:
    """The environments and steps of the rows marked in `which`, (n,) bool."""
    if which.all():
        return received.environment, received.step
    return received.environment[which], Step(*(field[which] for field in received.step))
