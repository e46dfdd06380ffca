"""Learning: makes the gradient updates that are due."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..core import Agent, Buffer, State
from ..core.schedules import Ratio

PRETRAINING_UPDATES_PER_ROUND = 64


class Means:
    """Running means of named scalars. It adds tensors as they are and reads their numbers in `read` only."""

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
        agent: makes the updates.
        buffer: gives the batches and gets the priorities.
        batch_size: transitions per update.
        replay_ratio: transitions learned from per environment step.
        environments: number of environments, which bounds the updates that may wait in async mode.
    """

    def __init__(
        self, agent: Agent[Any], buffer: Buffer[Any], batch_size: int, replay_ratio: float, environments: int
    ) -> None:
        self._agent, self._buffer, self._batch_size = agent, buffer, batch_size
        self._due = Ratio(replay_ratio / batch_size)
        self._owed = 0
        """Updates that are due and not made yet."""
        self._may_wait = math.ceil(environments * self._due.ratio)
        self.updates = 0
        self.metrics = Means()
        """What `agent.learn` returned."""

    def pretrain(self, updates: int) -> None:
        """Learn before the first environment step, until `updates` are made in all; some of them in each call."""
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
