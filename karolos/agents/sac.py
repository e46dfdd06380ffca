"""Soft actor-critic (Haarnoja et al. 2018, arXiv 1812.05905), with additions for robot tasks with sparse rewards."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from pydantic import Field as Setting
from pydantic import model_validator
from torch import Tensor

from ..core import Batch, Signature
from ..core.seeding import SeedTree
from .actor_critic import ActorCritic, ActorCriticSettings, imitation_loss
from .backprop import Tape
from .critics import QuantileCritic, Quantiles, ValueCritic
from .noise import NoiseSettings
from .optimisation import Adam, learning_rates
from .squashed_gaussian import Sample, log_probability, output_gradient, sample
from .tensors import REPORT_EVERY, TensorBatch, is_observed, saturation, tensor_batch


class SAC(ActorCritic):
    """A stochastic policy that maximises return plus entropy, and two critics, the smaller of which counts.

    Off-policy, continuous actions in [-1, 1]. The temperature, the weight of the entropy, is learned so that the
    policy's entropy comes near a target. Observations and goals are normalised by running statistics of the batches.
    With `critic` the critics give quantiles of the return, which is TQC (Kuznetsov et al. 2020, arXiv 2005.04269). With
    a correlated `noise` exploring actions are similar over time; each one still has the policy's distribution.

    Raises:
        UsageError: the environment takes discrete actions.
    """

    class Settings(ActorCriticSettings):
        temperature: float = Setting(0.05, gt=0, description="weight of the entropy at the start")
        temperature_min: float = Setting(0.0, ge=0, description="lower bound of the learned temperature")
        target_entropy: float | None = Setting(None, description="in nats; null: minus the number of action columns")
        entropy_in_target: bool = Setting(False, description="count the next action's entropy in the critics' target")
        critic: Quantiles | None = Setting(None, description="critics that give quantiles (TQC); null: values")
        policy_delay: int = Setting(1, ge=1, description="critic updates for each update of policy and temperature")
        noise: NoiseSettings = Setting(
            default_factory=NoiseSettings, description="of exploring actions; the policy gives its size"
        )
        random_actions: float = Setting(0.1, ge=0, le=1, description="share of exploring actions drawn uniformly")

        @model_validator(mode="after")
        def _bounds_hold(self) -> SAC.Settings:
            if self.entropy_in_target and self.clip_targets:
                raise ValueError("values that count entropy have no bounds from rewards: set clip_targets: false too")
            if self.temperature < self.temperature_min:
                raise ValueError(f"temperature {self.temperature} is below temperature_min {self.temperature_min}")
            return self

    shaping: ClassVar[tuple[str, ...]] = (*ActorCritic.shaping, "critic")
    learned: ClassVar[tuple[str, ...]] = ("policy", "critic", "target", "normaliser", "log_temperature")
    stored: tuple[str, ...] = ("policy", "critic", "target", "normaliser", "noise", "log_temperature")

    def __init__(self, settings: SAC.Settings, signature: Signature, seeds: SeedTree, device: str = "cpu") -> None:
        kind = QuantileCritic(settings.critic) if settings.critic else ValueCritic()
        super().__init__(settings, signature, seeds, device, critic_kind=kind, members=2, policy_columns=2)
        self.log_temperature = torch.full((1,), math.log(settings.temperature), device=self.device)
        self.optimisers["temperature"] = Adam(self.log_temperature, settings.rate)
        self._target_entropy = -float(self.actions) if settings.target_entropy is None else settings.target_entropy

    def explore(self, output: Tensor, noise: Tensor) -> Tensor:
        return sample(output, noise).action

    @torch.inference_mode()
    def learn(self, batch: Batch) -> Mapping[str, Any]:
        """One update: targets, critic step, policy step, temperature step, target networks."""
        update, delay = self.optimisers["critic"].steps, self.settings.policy_delay
        report, policy_turn = update % (REPORT_EVERY * delay) == 0, update % delay == 0
        data = tensor_batch(batch, self.normaliser, self.device, observe=is_observed(update))
        # One pass of the policy gives the actions in both s' and s: it changes after both are used.
        actions, tapes = self.sample(data.both_inputs if policy_turn else data.next_input)

        metrics = self.critic_step(data, self.targets(data, actions), report=report)
        if policy_turn:
            count = len(data.action)
            own = actions.rows(count)
            temperature, log_probabilities = self.log_temperature.exp(), log_probability(own)
            tapes = [tape.rows(count, count) for tape in tapes]
            metrics |= self._policy_step(data, own, tapes, temperature, log_probabilities, update, report=report)
            entropy = -log_probabilities.mean()
            self._temperature_step(entropy, update)
            if report:
                metrics |= {"entropy": entropy, "temperature": temperature.squeeze(0)}
        self.target.follow(self.critic, self.settings.tau)

        if report:
            metrics |= learning_rates(self.optimisers)
        return metrics

    def sample(self, inputs: Tensor) -> tuple[Sample, list[Tape]]:
        """a ~ pi(. | s), with the tapes of the policy network."""
        output, tapes = self.policy.forward(inputs)
        noise = torch.randn((len(inputs), self.actions), generator=self.generator, device=self.device)
        return sample(output, noise), tapes

    def targets(self, batch: TensorBatch, actions: Sample) -> Tensor:
        """y = r + discount (Q'(s', a') - temperature log pi(a' | s')), clipped to the possible values: (n, k).

        Source: Haarnoja et al. 2018, equations 3 and 5. The entropy counts with `entropy_in_target` only.

        Args:
            batch: n transitions.
            actions: a', the first n rows.
        """
        count = len(batch.action)
        outputs = self.target(torch.cat((batch.next_input, actions.action[:count]), 1))
        value = self.critic_kind.target_values(outputs)
        if self.settings.entropy_in_target:
            value = value - (self.log_temperature.exp() * log_probability(actions)[:count]).unsqueeze(1)
        return torch.addcmul(batch.reward.unsqueeze(1), batch.discount.unsqueeze(1), value).clamp_(*self.bounds)

    def _policy_step(
        self,
        batch: TensorBatch,
        own: Sample,
        tapes: list[Tape],
        temperature: Tensor,
        log_probabilities: Tensor,
        update: int,
        *,
        report: bool,
    ) -> dict[str, Any]:
        """One gradient step of the policy.

        Args:
            batch: n transitions.
            own: the policy's actions in s.
            tapes: of the policy network's pass that gave them.
            temperature: (1,).
            log_probabilities: log pi(own | s), (n,).
            update: updates made before this one.
            report: whether metrics are wanted.
        """
        settings, kind = self.settings, self.critic_kind
        outputs, critic_tapes = self.critic.forward(torch.cat((batch.input, own.action), 1))
        value = kind.policy_value(outputs)
        action_gradient = self.critic.backward(
            kind.policy_value_gradient(outputs, value, -batch.weight),
            critic_tapes,
            parameters=False,
            columns=slice(batch.input.shape[1], None),
        )
        assert action_gradient is not None
        if settings.action_penalty:
            action_gradient.add_(own.action, alpha=2 * settings.action_penalty / own.action.numel())
        gradient = policy_gradient(own, action_gradient, temperature, batch.weight)
        metrics: dict[str, Any] = {}
        if settings.imitation and batch.demonstrated is not None:
            mode = torch.tanh(own.unbounded - own.shift)
            demonstrated, current = (
                kind.policy_value(self.critic(torch.cat((batch.input, action), 1))) for action in (batch.action, mode)
            )
            metrics["imitation_loss"], mode_gradient = imitation_loss(mode, demonstrated > current, batch)
            gradient[:, : self.actions] += settings.imitation * mode_gradient * (1 - mode.square())
        metrics |= self.optimise_policy(gradient, tapes, update, report=report)
        if report:
            metrics["policy_loss"] = policy_loss(value, log_probabilities, temperature, batch.weight)
            metrics["action_saturation"] = saturation(own.action)
        return metrics

    def _temperature_step(self, entropy: Tensor, update: int) -> None:
        """One gradient step of the log temperature, which rises while the entropy is below its target."""
        self.optimisers["temperature"].step(temperature_gradient(entropy, self._target_entropy), update=update)
        if self.settings.temperature_min:
            self.log_temperature.clamp_(min=math.log(self.settings.temperature_min))


def policy_loss(value: Tensor, log_probabilities: Tensor, temperature: Tensor, weight: Tensor) -> Tensor:
    """L = sum_i weight_i (temperature log pi(a_i | s_i) - Q(s_i, a_i)). Source: Haarnoja et al. 2018, equation 7."""
    return torch.dot(weight, temperature * log_probabilities - value)


def policy_gradient(own: Sample, action_gradient: Tensor, temperature: Tensor, weight: Tensor) -> Tensor:
    """The gradient of the loss by the policy network's output, (n, 2 a); the action is reparameterised (equation 9).

    Args:
        own: a_i, (n, a).
        action_gradient: - weight dQ/da, (n, a), and the gradients of the additional terms.
        temperature: (1,). d loss / d log pi = temperature weight.
        weight: (n,).
    """
    return output_gradient(own, action_gradient, temperature * weight)


def temperature_gradient(entropy: Tensor, target: float) -> Tensor:
    """The gradient of L = log temperature (entropy - target) by the log temperature: (1,).

    Source: Haarnoja et al. 2018, equation 18, with log temperature in place of the temperature, as in their code.
    """
    return (entropy - target).view(1)
