"""Twin delayed deterministic policy gradient (Fujimoto et al. 2018, arXiv 1802.09477)."""

from __future__ import annotations

from typing import Any

from pydantic import Field as Setting

from .deterministic import Deterministic, DeterministicSettings, Variant


class TD3(Deterministic):
    """DDPG with three cures for overestimated values: two critics, delayed policy updates, noise on target actions.

    Off-policy, continuous actions in [-1, 1].

    Raises:
        UsageError: the environment takes discrete actions.
    """

    class Settings(DeterministicSettings):
        target_noise: float = Setting(0.2, ge=0, description="standard deviation of noise on targets' actions")
        noise_clip: float = Setting(0.5, ge=0, description="largest such noise")
        policy_delay: int = Setting(2, ge=1, description="critic updates for each update of policy and targets")

    @staticmethod
    def variant_of(settings: Any) -> Variant:
        return Variant(
            "td3",
            critics=2,
            target_noise=settings.target_noise,
            noise_clip=settings.noise_clip,
            policy_delay=settings.policy_delay,
        )
