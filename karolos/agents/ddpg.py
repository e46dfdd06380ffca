"""Deep deterministic policy gradient (Lillicrap et al. 2015, arXiv 1509.02971)."""

from __future__ import annotations

from typing import Any

from .deterministic import Deterministic, DeterministicSettings, Variant


class DDPG(Deterministic):
    """A deterministic policy that climbs the value its critic gives to actions.

    Off-policy, continuous actions in [-1, 1]. By default it explores with Gaussian noise and a share of uniform
    actions, as OpenAI's hindsight experiments did (Plappert et al. 2018), not with the paper's Ornstein-Uhlenbeck
    process, which is `noise: {kind: ornstein_uhlenbeck}`.

    Raises:
        UsageError: the environment takes discrete actions.
    """

    class Settings(DeterministicSettings):
        """As of every agent with a deterministic policy."""

    @staticmethod
    def variant_of(settings: Any) -> Variant:  # noqa: ARG004 (nothing sets this one apart)
        return Variant("ddpg")
