"""What training goes by and what it tells: the amounts, where it stands after a round, how old its actions are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..core import Failure
from .episodes import Episode

Metrics = tuple[Mapping[str, Any], ...]


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
class PolicyLag:
    """Gradient updates between choosing an action and storing its transition, since the last reading."""

    _sum: int = 0
    _count: int = 0
    _most: int = 0

    def add(self, lags: np.ndarray) -> None:
        """Take note of the lags (n,) of n transitions."""
        if lags.size:
            self._sum += int(lags.sum())
            self._count += lags.size
            self._most = max(self._most, int(lags.max()))

    def read(self) -> dict[str, float]:
        """Mean and maximum; nothing where nothing was stored."""
        found = {"policy_lag_mean": self._sum / self._count, "policy_lag_max": self._most} if self._count else {}
        self._sum = self._count = self._most = 0
        return found
