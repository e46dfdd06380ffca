"""Noise of exploring actions: standard normal at each step, independent or correlated over steps."""

from __future__ import annotations

from typing import Literal, Self

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field as Setting
from pydantic import model_validator
from torch import Tensor

from ..core import Settings as BaseSettings
from ..core import State

THETA = 0.15
"""Source: Lillicrap et al. 2015, section 7."""
INTERVAL = 8
"""A third of a second at 24 Hz. Raffin et al. 2021 sample a new matrix every 4 to 64 steps, depending on the task."""


class NoiseSettings(BaseSettings):
    """Settings of noise that the policy scales."""

    kind: Literal["gaussian", "ornstein_uhlenbeck", "state_dependent"] = Setting(
        default="gaussian",
        description="gaussian: independent at each step; ornstein_uhlenbeck: correlated over an episode; "
        "state_dependent: a random function of the observation, sampled again at intervals",
    )
    theta: float | None = Setting(
        default=None,
        gt=0,
        le=1,
        description=f"ornstein_uhlenbeck: share of the noise that decays per step; null: {THETA}",
    )
    interval: int | None = Setting(
        default=None, ge=1, description=f"state_dependent: steps until the function is sampled again; null: {INTERVAL}"
    )

    @model_validator(mode="after")
    def _each_has_its_own(self) -> Self:
        for name, kind in (("theta", "ornstein_uhlenbeck"), ("interval", "state_dependent")):
            if getattr(self, name) is not None and self.kind != kind:
                raise ValueError(f"{name} goes with kind: {kind}, not with {self.kind}")
        return self


class ScaledNoiseSettings(NoiseSettings):
    """Settings of noise on a deterministic policy's actions."""

    std: float = Setting(default=0.2, ge=0, description="standard deviation per action column, for every kind")


class Noise:
    """Draws noise for each of several environments; every column is standard normal for every kind.

    gaussian: independent.
    ornstein_uhlenbeck: x' = (1 - theta) x + sqrt(theta (2 - theta)) e with e ~ N(0, 1) (Uhlenbeck, Ornstein 1930, at
        steps of 1). It starts standard normal and stays so.
    state_dependent: M^T z / |z|, with the normalised inputs and a 1 as features z, and a matrix M of standard normal
        numbers per environment, sampled at the beginning of an episode and every `interval` steps. Generalised
        state-dependent exploration (Raffin et al. 2021) learns a standard deviation for each feature. Here the policy
        gives it, so that actions have the density that the policy's loss assumes.

    Args:
        inputs: columns of the policy's input.
        actions: columns of an action.
    """

    def __init__(self, settings: NoiseSettings, inputs: int, actions: int, device: torch.device) -> None:
        self._kind = settings.kind
        self._theta = settings.theta or THETA
        self._interval = settings.interval or INTERVAL
        rows = {"gaussian": 0, "ornstein_uhlenbeck": 1, "state_dependent": inputs + 1}[settings.kind]
        self._memory = torch.zeros((0, rows, actions), device=device)
        """The last noise, or the matrix, of each environment."""
        self._age = np.zeros(0, np.int64)
        """Draws so far in each environment's episode."""

    def begin(self, environments: NDArray[np.int64]) -> None:
        """Reset the noise of environments where a new episode begins."""
        self._age[environments[environments < len(self._age)]] = 0

    def draw(self, rows: Tensor, generator: torch.Generator, environments: NDArray[np.int64] | None = None) -> Tensor:
        """Noise (n, a) for these environments (n,) (None: 0 .. n - 1), whose policy inputs are `rows` (n, i)."""
        if self._kind == "gaussian":
            return torch.randn((len(rows), self._memory.shape[2]), generator=generator, device=rows.device)
        if environments is None:
            environments = np.arange(len(rows))
        more = int(environments.max(initial=-1)) + 1 - len(self._age)
        if more > 0:  # new environments are at the beginning of an episode
            self._age = np.concatenate((self._age, np.zeros(more, np.int64)))
            self._memory = torch.cat((self._memory, self._memory.new_zeros((more, *self._memory.shape[1:]))))
        where, age = torch.from_numpy(environments).to(rows.device), self._age[environments]
        memory = self._memory[where]
        correlated = self._kind == "ornstein_uhlenbeck"
        renewed = age == 0 if correlated else age % self._interval == 0
        if correlated or renewed.any():
            drawn = torch.randn(memory.shape, generator=generator, device=rows.device)
            if correlated:
                memory = (1 - self._theta) * memory + (self._theta * (2 - self._theta)) ** 0.5 * drawn
            memory = torch.where(torch.from_numpy(renewed).to(rows.device).view(-1, 1, 1), drawn, memory)
        self._age[environments] += 1
        self._memory[where] = memory
        if correlated:
            return memory[:, 0]
        features = torch.cat((rows, rows.new_ones((len(rows), 1))), 1)
        features = features / torch.linalg.vector_norm(features, dim=1, keepdim=True)
        return torch.bmm(features.unsqueeze(1), memory).squeeze(1)

    def state(self) -> State:
        return {"memory": self._memory.clone(), "age": self._age.copy()}

    def load_state(self, state: State) -> None:
        memory, age = torch.as_tensor(state["memory"]), np.array(state["age"], np.int64)
        if memory.shape[1:] != self._memory.shape[1:] or age.shape != memory.shape[:1]:
            raise ValueError(f"the noise has the shapes {tuple(memory.shape)} and {age.shape}")
        self._memory, self._age = memory.clone().to(self._memory.device), age
