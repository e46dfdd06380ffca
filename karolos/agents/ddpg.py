"""Deep deterministic policy gradient (Lillicrap et al. 2015, arXiv 1509.02971)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from pydantic import Field as Setting
from torch import Tensor

from ..core import Batch, Signature
from ..core.seeding import SeedTree
from .actor_critic import ActorCritic, ActorCriticSettings, imitation_loss
from .critics import ValueCritic
from .noise import ScaledNoiseSettings
from .optimisation import learning_rates
from .tensors import REPORT_EVERY, TensorBatch, is_observed, saturation, tensor_batch


class DDPG(ActorCritic):
    """A deterministic policy that maximises the value its critic gives to its actions.

    Off-policy, continuous actions in [-1, 1]. By default it explores with Gaussian noise and some uniform actions, as
    in Plappert et al. 2018. The Ornstein-Uhlenbeck process of the paper is `noise: {kind: ornstein_uhlenbeck}`.

    Raises:
        UsageError: the environment takes discrete actions.
    """

    class Settings(ActorCriticSettings):
        noise: ScaledNoiseSettings = Setting(default_factory=ScaledNoiseSettings, description="on exploring actions")
        random_actions: float = Setting(0.3, ge=0, le=1, description="share of exploring actions drawn uniformly")

    learned: ClassVar[tuple[str, ...]] = ("policy", "critic", "target_policy", "target", "normaliser")
    stored: tuple[str, ...] = (*learned, "noise", "updates")
    critics: ClassVar[int] = 1

    def __init__(self, settings: Any, signature: Signature, seeds: SeedTree, device: str = "cpu") -> None:
        super().__init__(
            settings, signature, seeds, device, critic_kind=ValueCritic(), members=self.critics, policy_columns=1
        )
        self.target_policy = self.policy.copy()
        self.policy_delay = 1
        """Critic updates for each update of policy and target networks."""
        self.updates = 0

    def explore(self, output: Tensor, noise: Tensor) -> Tensor:
        return torch.add(torch.tanh(output), noise, alpha=self.settings.noise.std).clamp_(-1, 1)

    @torch.inference_mode()
    def learn(self, batch: Batch) -> Mapping[str, Any]:
        """One update: targets, critic step, and when it is their turn policy step and target networks."""
        update = self.updates
        report = update // self.policy_delay % REPORT_EVERY == 0
        data = tensor_batch(batch, self.normaliser, self.device, observe=is_observed(update))
        self.updates += 1
        metrics = self.critic_step(data, self.targets(data), report=report)
        if self.updates % self.policy_delay == 0:
            metrics |= self._policy_step(data, update, report=report)
            self.target.follow(self.critic, self.settings.tau)
            self.target_policy.follow(self.policy, self.settings.tau)
        if report:
            metrics |= learning_rates(self.optimisers)
        return metrics

    def targets(self, batch: TensorBatch) -> Tensor:
        """y = r + discount min_j Q'_j(s', a'), clipped to the possible values: (n, 1)."""
        action = self.next_action(batch.next_input)
        outputs = self.target(torch.cat((batch.next_input, action), 1))
        value = self.critic_kind.target_values(outputs)
        return torch.addcmul(batch.reward.unsqueeze(1), batch.discount.unsqueeze(1), value).clamp_(*self.bounds)

    def next_action(self, next_input: Tensor) -> Tensor:
        """a' = pi'(s'), of the target policy: (n, a)."""
        return torch.tanh(self.target_policy(next_input))

    def _policy_step(self, batch: TensorBatch, update: int, *, report: bool) -> dict[str, Any]:
        """One gradient step of the policy; the first critic alone judges its actions."""
        settings = self.settings
        output, tapes = self.policy.forward(batch.input)
        action = torch.tanh(output)
        values, critic_tapes = self.critic.forward(torch.cat((batch.input, action), 1), first=True)
        value, value_gradient = values[0, :, 0], torch.zeros_like(values)
        value_gradient[0, :, 0] = -batch.weight
        action_gradient = self.critic.backward(
            value_gradient, critic_tapes, parameters=False, columns=slice(batch.input.shape[1], None)
        )
        assert action_gradient is not None
        metrics: dict[str, Any] = {}
        if report:
            metrics |= {"policy_loss": policy_loss(value, batch.weight), "action_saturation": saturation(action)}
        if settings.action_penalty:
            action_gradient.add_(action, alpha=2 * settings.action_penalty / action.numel())
        if settings.imitation and batch.demonstrated is not None:
            demonstrated = self.critic.forward(torch.cat((batch.input, batch.action), 1), first=True)[0][0, :, 0]
            metrics["imitation_loss"], gradient = imitation_loss(action, demonstrated > value, batch)
            action_gradient.add_(gradient, alpha=settings.imitation)
        return metrics | self.optimise_policy(policy_gradient(action, action_gradient), tapes, update, report=report)


def policy_loss(value: Tensor, weight: Tensor) -> Tensor:
    """L = - sum_i weight_i Q(s_i, pi(s_i)). Source: Lillicrap et al. 2015, equation 6; Silver et al. 2014."""
    return -torch.dot(weight, value)


def policy_gradient(action: Tensor, action_gradient: Tensor) -> Tensor:
    """The gradient of the loss by the policy's output u, with pi(s) = tanh(u): dL/du = dL/da (1 - a^2).

    Args:
        action: a = tanh(u), (n, a).
        action_gradient: dL/da, (n, a): - weight dQ/da, and the gradients of the additional terms.
    """
    return action_gradient * (1 - action.square())
