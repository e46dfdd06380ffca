"""Twin delayed deterministic policy gradient (Fujimoto et al. 2018, arXiv 1802.09477)."""

from __future__ import annotations

from typing import ClassVar

import torch
from pydantic import Field as Setting
from torch import Tensor

from ..core import SeedTree, Signature
from .ddpg import DDPG


class TD3(DDPG):
    """DDPG with three remedies against overestimation: two critics, delayed policy steps, noise on target actions.

    Off-policy, continuous actions in [-1, 1].

    Raises:
        UsageError: the environment takes discrete actions.
    """

    class Settings(DDPG.Settings):
        target_noise: float = Setting(0.2, ge=0, description="standard deviation of noise on the target's action")
        noise_clip: float = Setting(0.5, ge=0, description="largest noise on the target's action")
        policy_delay: int = Setting(2, ge=1, description="critic updates for each update of policy and target networks")

    critics: ClassVar[int] = 2

    def __init__(self, settings: TD3.Settings, signature: Signature, seeds: SeedTree, device: str = "cpu") -> None:
        super().__init__(settings, signature, seeds, device)
        self.policy_delay = settings.policy_delay

    def next_action(self, next_input: Tensor) -> Tensor:
        """a' = clip(pi'(s') + clip(noise, -c, c), -1, 1): target policy smoothing, equation 14."""
        action = super().next_action(next_input)
        if not self.settings.target_noise:
            return action
        noise = torch.randn(action.shape, generator=self.generator, device=self.device)
        clip = self.settings.noise_clip
        return (action + noise.mul_(self.settings.target_noise).clamp_(-clip, clip)).clamp_(-1, 1)
