"""Soft actor-critic (Haarnoja et al. 2018, arXiv 1812.05905), with additions for robot tasks with sparse rewards."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Self

import torch
from pydantic import Field as Setting
from pydantic import model_validator
from torch import Tensor

from ..core import Batch, SeedTree, Signature
from .actor_critic import ActorCritic, ActorCriticSettings, QuantileCritic, Quantiles, imitation_loss
from .inputs import TensorBatch
from .noise import NoiseSettings
from .optimisation import Adam, Metrics, report, saturation
from .squashed_gaussian import SquashedActions, squashed


class SAC(ActorCritic):
    """A stochastic policy that maximises return plus entropy, and two critics, of which the smaller value counts.

    Off-policy, continuous actions in [-1, 1]. The temperature, the weight of the entropy, is learned so that the
    policy's entropy comes near a target. Observations and goals are normalised by running statistics of the batches.
    With `critic` the critics give quantiles of the return, which is TQC (Kuznetsov et al. 2020, arXiv 2005.04269). With
    a correlated `noise` exploring actions are similar over time; each one still has the policy's distribution.

    Raises:
        UsageError: the environment takes discrete actions.
    """

    class Settings(ActorCriticSettings):
        temperature: float = Setting(0.05, gt=0, description="initial weight of the entropy")
        temperature_min: float = Setting(0.0, ge=0, description="lower bound of the learned temperature")
        target_entropy: float | None = Setting(None, description="in nats; null: minus the number of action columns")
        entropy_in_target: bool = Setting(False, description="include the next action's entropy in the targets")
        critic: Quantiles | None = Setting(None, description="critics that predict quantiles (TQC); null: values")
        policy_delay: int = Setting(1, ge=1, description="critic updates for each update of policy and temperature")
        noise: NoiseSettings = Setting(
            default_factory=NoiseSettings, description="of exploring actions; the policy gives its size"
        )
        random_actions: float = Setting(0.1, ge=0, le=1, description="share of uniformly random exploring actions")

        @model_validator(mode="after")
        def _bounds_hold(self) -> Self:
            if self.entropy_in_target and self.clip_targets:
                raise ValueError(
                    "values with entropy_in_target are not bounded by rewards: also set clip_targets: false"
                )
            if self.temperature < self.temperature_min:
                raise ValueError(f"temperature {self.temperature} is below temperature_min {self.temperature_min}")
            return self

    shaping: ClassVar[tuple[str, ...]] = (*ActorCritic.shaping, "critic")
    learned: ClassVar[tuple[str, ...]] = ("policy", "critic", "target", "normaliser", "log_temperature")
    stored: tuple[str, ...] = ("policy", "critic", "target", "normaliser", "noise", "log_temperature")
    policy_columns: ClassVar[int] = 2

    def __init__(self, settings: SAC.Settings, signature: Signature, seeds: SeedTree, device: str = "cpu") -> None:
        if settings.critic:
            self.critic_kind = QuantileCritic(settings.critic)
        super().__init__(settings, signature, seeds, device)
        self.log_temperature = torch.full((1,), math.log(settings.temperature), device=self.device)
        self.optimisers["temperature"] = Adam(self.log_temperature, settings.learning_rate)
        self._target_entropy = -float(self.actions) if settings.target_entropy is None else settings.target_entropy

    def noisy(self, output: Tensor, noise: Tensor) -> Tensor:
        return squashed(output, noise).action

    @torch.inference_mode()
    def learn(self, batch: Batch) -> Mapping[str, Any]:
        """One update: targets, critics, policy, temperature, target networks."""
        update, delay = self.optimisers["critic"].steps, self.settings.policy_delay
        data = self.begin_update(batch, update)
        policy_learns = update % delay == 0
        # One pass of the policy gives the actions in both s' and s: it changes after both are used.
        drawn = self.draw(data.both_inputs if policy_learns else data.next_input)
        next_actions, actions = drawn.split(len(data.action))

        targets = self.targets(data, next_actions.action, self.counted_entropy(next_actions))
        metrics = self.critic_step(data, targets)
        if policy_learns:
            log_probability = actions.log_probability()
            metrics |= self.policy_step(data, actions, log_probability)
            metrics |= self.temperature_step(-log_probability.mean())
        self.target.follow(self.critic, self.settings.tau)
        return report(metrics, self.optimisers, update // delay)

    def draw(self, inputs: Tensor) -> SquashedActions:
        """a ~ pi(. | s)."""
        output, tapes = self.policy.forward(inputs)
        noise = torch.randn((len(inputs), self.actions), generator=self.generator, device=self.device)
        return squashed(output, noise, tapes)

    def counted_entropy(self, actions: SquashedActions) -> Tensor | None:
        """- temperature log pi(a | s), (n,), if it counts in the critics' targets."""
        return -(self.log_temperature.exp() * actions.log_probability()) if self.settings.entropy_in_target else None

    def policy_step(self, batch: TensorBatch, own: SquashedActions, log_probability: Tensor) -> Metrics:
        """One gradient step of the policy on L = sum_i weight_i (temperature log pi(a_i | s_i) - Q(s_i, a_i)).

        Source: Haarnoja et al. 2018, equation 7; the action is reparameterised (equation 9). d L / d log pi =
        temperature weight.
        """
        temperature = self.log_temperature.exp()
        values, by_action = self.values_and_gradient(batch, own.action)
        entropy_weight = 0 * batch.weight if self.settings.cloning else temperature * batch.weight
        by_output = own.backward(by_action, entropy_weight)
        metrics: Metrics = {
            "policy_loss": lambda: torch.dot(batch.weight, temperature * log_probability - values),
            "action_saturation": lambda: saturation(own.action),
        }
        if self.settings.imitation and batch.demonstrated is not None:
            mode = own.mode()
            metrics["imitation_loss"], by_mode = imitation_loss(mode, self.preferred(batch, mode), batch)
            by_output[:, : self.actions] += self.settings.imitation * by_mode * (1 - mode.square())
        return metrics | self.step_policy(by_output, own.tapes)

    def temperature_step(self, entropy: Tensor) -> Metrics:
        """One gradient step on L = log temperature (entropy - target): it rises while the entropy is below its target.

        Source: Haarnoja et al. 2018, equation 18, with log temperature in place of the temperature, as in their code.
        """
        temperature = self.log_temperature.exp()
        self.optimisers["temperature"].step((entropy - self._target_entropy).view(1))
        if self.settings.temperature_min:
            self.log_temperature.clamp_(min=math.log(self.settings.temperature_min))
        return {"entropy": entropy, "temperature": temperature.squeeze(0)}
