"""Soft actor-critic (Haarnoja et al. 2018, arXiv 1812.05905), with what sparse-reward robot tasks need on top."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from numpy import int64
from numpy.typing import NDArray
from pydantic import Field as Setting
from pydantic import model_validator
from torch import Tensor

from ..core import Agent, Batch, FloatArray, Signature, State
from ..seeding import SeedTree
from .actor_critic import ActorCriticSettings, critic_metrics, imitation_loss, load_parts, parts_state
from .device import is_low
from .inputs import (
    Inputs,
    acting_inputs,
    learning_inputs,
    require_continuous,
    saturation,
    some_random,
    to_array,
    value_bounds,
)
from .networks import MLP, Shape
from .noise import Noise, NoiseSettings
from .normaliser import Normaliser
from .optimisation import Adam
from .quantiles import Quantiles, quantile_huber, truncated
from .squashed_gaussian import mode, sample

PARTS = ("policy", "critic", "target", "normaliser", "noise")


class SAC(Agent):
    """A stochastic policy that maximises return plus entropy, and two critics of which the smaller counts.

    Off-policy, continuous actions in [-1, 1]. The temperature that weighs entropy is learned, so that the policy's
    entropy comes near a target. Observations and goals are normalised by running statistics of what was learned from.
    With `critic` each critic gives quantiles of the return and the largest are left out of targets, which makes it TQC
    (Kuznetsov et al. 2020, arXiv 2005.04269). With a `noise` that lasts, exploring actions hang together over time;
    each alone has the distribution that the policy gives it.

    Raises:
        UsageError: the environment takes discrete actions.
    """

    class Settings(ActorCriticSettings):
        temperature: float = Setting(0.05, gt=0, description="weight of the entropy at the start")
        temperature_min: float = Setting(0.0, ge=0, description="the learned temperature never falls below this")
        target_entropy: float | None = Setting(None, description="in nats; null: minus the number of action columns")
        entropy_in_target: bool = Setting(False, description="count the next action's entropy in the critics' target")
        critic: Quantiles | None = Setting(None, description="critics that give quantiles (TQC); null: values")
        noise: NoiseSettings = Setting(
            default_factory=NoiseSettings, description="of exploring actions; the policy gives its size"
        )
        random_actions: float = Setting(0.1, ge=0, le=1, description="share of exploring actions drawn uniformly")

        @model_validator(mode="after")
        def _bounds_hold(self) -> SAC.Settings:
            if self.entropy_in_target and self.clip_targets:
                raise ValueError("the reward range bounds no value that counts entropy: set clip_targets: false too")
            if self.temperature < self.temperature_min:
                raise ValueError(f"temperature {self.temperature} is below temperature_min {self.temperature_min}")
            return self

    on_policy: ClassVar[bool] = False
    learned: ClassVar[tuple[str, ...]] = ("policy", "critic", "target", "normaliser", "log_temperature")

    def __init__(self, settings: SAC.Settings, signature: Signature, seeds: SeedTree, device: str = "cpu") -> None:
        actions = require_continuous(signature, "sac")
        self.settings, self.device, self.discount = settings, torch.device(device), settings.discount
        inputs = signature.observation.size + signature.desired_goal.size
        low = is_low(settings.precision, device)
        drawn = torch.Generator().manual_seed(seeds.child("weights").integer())
        self.policy = MLP(Shape((inputs, *settings.hidden, 2 * actions), low=low), drawn, device)
        sizes = (inputs + actions, *settings.hidden, settings.critic.quantiles if settings.critic else 1)
        self.critic = MLP(Shape(sizes, members=2, layer_norm=settings.layer_norm, low=low), drawn, device)
        self.target = self.critic.copy()
        self.normaliser = Normaliser(inputs, device)
        self.noise = Noise(settings.noise, inputs, actions, self.device)
        self.log_temperature = torch.full((1,), math.log(settings.temperature), device=self.device)
        self.optimisers = {
            "policy": Adam(self.policy.leaf, settings.rate, norm=settings.gradient_norm),
            "critic": Adam(self.critic.leaf, settings.rate, norm=settings.gradient_norm),
            "temperature": Adam(self.log_temperature, settings.rate),
        }
        self.generator = torch.Generator(self.device).manual_seed(seeds.child("noise").integer())
        self._target_entropy = -float(actions) if settings.target_entropy is None else settings.target_entropy
        self._least_log_temperature = math.log(settings.temperature_min) if settings.temperature_min else -math.inf
        self._bounds = value_bounds(signature, settings.discount, clip=settings.clip_targets)

    @torch.inference_mode()
    def act(
        self,
        observation: FloatArray,
        desired_goal: FloatArray,
        *,
        explore: bool,
        environments: NDArray[int64] | None = None,
    ) -> FloatArray:
        """Actions (n, a) in [-1, 1] for observations (n, o) and goals (n, g)."""
        rows = acting_inputs(observation, desired_goal, self.normaliser, self.device)
        head = self.policy(rows, exact=True)
        if not explore:
            return to_array(mode(head))
        action = sample(head, self.noise.draw(rows, self.generator, environments)).action
        return to_array(some_random(action, self.settings.random_actions, self.generator))

    def begin_episodes(self, environments: NDArray[int64]) -> None:
        self.noise.begin(environments)

    def learn(self, batch: Batch) -> Mapping[str, Any]:
        """One update of critics, policy, temperature and targets, in this order; metrics as tensors."""
        inputs = learning_inputs(batch, self.normaliser, self.device)
        metrics = self._learn_critic(inputs)
        metrics |= self._learn_policy(inputs)
        self.target.follow(self.critic, self.settings.tau)
        return metrics

    def _sample(self, rows: Tensor, *, learn: bool = False) -> tuple[Tensor, Tensor, Tensor]:
        """What the policy gives out, actions (n, a) drawn from it, and their log-probabilities (n,)."""
        head = self.policy(rows, learn=learn)
        noise = torch.randn((len(rows), head.shape[1] // 2), generator=self.generator, device=self.device)
        return head, *sample(head, noise)

    @torch.no_grad()
    def targets(self, inputs: Inputs) -> Tensor:
        """What the critics should say: (n,), or (n, k) samples of it where they give quantiles."""
        _, action, log_probability = self._sample(inputs.there)
        values = self.target(torch.cat((inputs.there, action), 1))
        critic = self.settings.critic
        value = truncated(values, critic.drop) if critic else values.squeeze(-1).amin(0).unsqueeze(1)
        if self.settings.entropy_in_target:
            value = value - (self.log_temperature.exp() * log_probability).unsqueeze(1)
        target = torch.addcmul(inputs.reward.unsqueeze(1), inputs.discount.unsqueeze(1), value).clamp_(*self._bounds)
        return target if critic else target.squeeze(1)

    def _learn_critic(self, inputs: Inputs) -> dict[str, Any]:
        targets = self.targets(inputs)
        values = self.critic(torch.cat((inputs.here, inputs.action), 1), learn=True)
        if self.settings.critic:
            loss = quantile_huber(values, targets, inputs.weight)
            values, targets = values.mean(-1), targets.mean(-1)
        else:
            values = values.squeeze(-1)
            loss = (inputs.weight * (values - targets).square()).mean(1).sum()
        return critic_metrics(loss, values, targets, self.optimisers["critic"].step(loss))

    def _value(self, inputs: Inputs, action: Tensor) -> Tensor:
        """What actions are worth to the policy: the smaller critic, or the mean of all quantiles. (n,)."""
        values = self.critic(torch.cat((inputs.here, action), 1))
        return values.mean((0, 2)) if self.settings.critic else values.squeeze(-1).amin(0)

    def _learn_policy(self, inputs: Inputs) -> dict[str, Any]:
        head, action, log_probability = self._sample(inputs.here, learn=True)
        temperature = self.log_temperature.exp()
        loss = (inputs.weight * (temperature * log_probability - self._value(inputs, action))).mean()
        metrics = {"policy_loss": loss.detach()}
        if self.settings.action_penalty:
            loss = loss + self.settings.action_penalty * action.square().mean()
        if self.settings.imitation and inputs.demonstrated is not None:
            middle = mode(head)
            with torch.no_grad():
                better = self._value(inputs, inputs.action) > self._value(inputs, middle)
            distance = imitation_loss(middle, better, inputs)
            loss = loss + self.settings.imitation * distance
            metrics["imitation_loss"] = distance.detach()
        length = self.optimisers["policy"].step(loss)
        entropy = -log_probability.detach().mean()
        self._learn_temperature(entropy)
        return {
            **metrics,
            "policy_gradient_norm": length,
            "entropy": entropy,
            "temperature": temperature.squeeze(0),
            "action_saturation": saturation(action),
        }

    def _learn_temperature(self, entropy: Tensor) -> None:
        """Raise the temperature while the policy's entropy is under its target. The gradient is written down."""
        self.optimisers["temperature"].step_along((entropy - self._target_entropy).view(1))
        self.log_temperature.clamp_(min=self._least_log_temperature)

    def state(self) -> State:
        """Everything that learning and acting depend on."""
        return {**parts_state(self, PARTS), "log_temperature": self.log_temperature.clone()}

    def load_state(self, state: State) -> None:
        """Raises UsageError when the state is of networks of another shape."""
        load_parts(self, PARTS, state)
        self.log_temperature.copy_(torch.as_tensor(state["log_temperature"]))
