"""Deep deterministic policy gradient (Lillicrap et al. 2015, arXiv 1509.02971)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from pydantic import Field as Setting
from torch import Tensor

from ..core import Batch, Deployed, SeedTree, Signature
from .actor_critic import ActorCritic, ActorCriticSettings, imitation_loss
from .inputs import TensorBatch
from .noise import ScaledNoiseSettings
from .optimisation import Metrics, report, saturation


class DDPG(ActorCritic):
    """A deterministic policy that maximises the critic's value of its actions.

    Off-policy, continuous actions in [-1, 1]. By default it explores with Gaussian noise and some uniform actions, as
    in Plappert et al. 2018. The Ornstein-Uhlenbeck process of the paper is `noise: {kind: ornstein_uhlenbeck}`.

    Raises:
        UsageError: the environment takes discrete actions.
    """

    class Settings(ActorCriticSettings):
        noise: ScaledNoiseSettings = Setting(default_factory=ScaledNoiseSettings, description="on exploring actions")
        random_actions: float = Setting(0.3, ge=0, le=1, description="share of uniformly random exploring actions")

    learned: ClassVar[tuple[str, ...]] = ("policy", "critic", "target_policy", "target", "normaliser")
    stored: tuple[str, ...] = (*learned, "noise", "updates")
    critics: ClassVar[int] = 1
    judges: ClassVar[int | None] = 1
    policy_delay: int = 1
    """Critic updates for each update of policy and target networks."""

    def __init__(self, settings: Any, signature: Signature, seeds: SeedTree, device: str = "cpu") -> None:
        super().__init__(settings, signature, seeds, device)
        self.target_policy = self.policy.copy()
        self.updates = 0

    def adopt(self, policy: Deployed) -> None:
        super().adopt(policy)
        self.target_policy.vector.copy_(self.policy.vector)

    def noisy(self, output: Tensor, noise: Tensor) -> Tensor:
        return torch.add(torch.tanh(output), noise, alpha=self.settings.noise.std).clamp_(-1, 1)

    @torch.inference_mode()
    def learn(self, batch: Batch) -> Mapping[str, Any]:
        """One update: targets and critics; in every `policy_delay`-th update also policy and target networks."""
        update = self.updates
        data = self.begin_update(batch, update)
        self.updates += 1
        metrics = self.critic_step(data, self.targets(data, self.next_action(data.next_input)))
        if self.updates % self.policy_delay == 0:
            metrics |= self.policy_step(data)
            self.target.follow(self.critic, self.settings.tau)
            self.target_policy.follow(self.policy, self.settings.tau)
        return report(metrics, self.optimisers, update // self.policy_delay)

    def next_action(self, next_input: Tensor) -> Tensor:
        """a' = pi'(s'), of the target policy: (n, a)."""
        return torch.tanh(self.target_policy(next_input))

    def policy_step(self, batch: TensorBatch) -> Metrics:
        """One gradient step of the policy on L = - sum_i weight_i Q(s_i, pi(s_i)), with Q of the first critic.

        Source: Lillicrap et al. 2015, equation 6; Silver et al. 2014. pi(s) = tanh(u): dL/du = dL/da (1 - a^2).
        """
        output, tapes = self.policy.forward(batch.input)
        action = torch.tanh(output)
        values, by_action = self.values_and_gradient(batch, action)
        metrics: Metrics = {
            "policy_loss": lambda: -torch.dot(batch.weight, values),
            "action_saturation": lambda: saturation(action),
        }
        if self.settings.imitation and batch.demonstrated is not None:
            metrics["imitation_loss"], gradient = imitation_loss(action, self.preferred(batch, action), batch)
            by_action.add_(gradient, alpha=self.settings.imitation)
        return metrics | self.step_policy(by_action * (1 - action.square()), tapes)
