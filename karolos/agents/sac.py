"""Soft actor-critic (Haarnoja et al. 2018, arXiv 1812.05905), with what sparse-reward robot tasks need on top."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import torch
from pydantic import Field as Setting
from pydantic import model_validator
from torch import Tensor

from ..core import Agent, Batch, FloatArray, Signature, State
from ..core import Settings as BaseSettings
from ..seeding import SeedTree
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
from .normaliser import Normaliser
from .optimisation import Adam
from .squashed_gaussian import mode, sample


class SAC(Agent):
    """A stochastic policy that maximises return plus entropy, and two critics of which the smaller counts.

    Off-policy, continuous actions in [-1, 1]. The temperature that weighs entropy is learned, so that the policy's
    entropy comes near a target. Observations and goals are normalised by running statistics of what was learned from.

    Raises:
        UsageError: the environment takes discrete actions.
    """

    class Settings(BaseSettings):
        learning_rate: float = Setting(1e-3, gt=0, description="of policy, critics and temperature (Adam)")
        discount: float = Setting(0.95, ge=0, lt=1, description="per environment step; about 1 - 1 / steps of episode")
        hidden: tuple[int, ...] = Setting((256, 256), min_length=1, description="units of each hidden layer")
        tau: float = Setting(0.05, gt=0, le=1, description="share of the critics that their targets take per update")
        temperature: float = Setting(0.05, gt=0, description="weight of the entropy at the start")
        temperature_min: float = Setting(0.0, ge=0, description="the learned temperature never falls below this")
        target_entropy: float | None = Setting(None, description="in nats; null: minus the number of action columns")
        layer_norm: bool = Setting(False, description="layer-normalised critics: steadier, a little slower")
        entropy_in_target: bool = Setting(False, description="count the next action's entropy in the critics' target")
        clip_targets: bool = Setting(True, description="cut targets to what the declared reward range makes possible")
        random_actions: float = Setting(0.1, ge=0, le=1, description="share of exploring actions drawn uniformly")
        precision: Literal["float32", "bfloat16"] = Setting(
            "bfloat16", description="of the wide products while learning; sums, inputs and outputs stay float32"
        )

        @model_validator(mode="after")
        def _bounds_hold(self) -> SAC.Settings:
            if self.entropy_in_target and self.clip_targets:
                raise ValueError("the reward range bounds no value that counts entropy: set clip_targets: false too")
            if self.temperature < self.temperature_min:
                raise ValueError(f"temperature {self.temperature} is below temperature_min {self.temperature_min}")
            return self

    on_policy: ClassVar[bool] = False

    def __init__(self, settings: SAC.Settings, signature: Signature, seeds: SeedTree, device: str = "cpu") -> None:
        actions = require_continuous(signature, "sac")
        self.settings, self.device, self.discount = settings, torch.device(device), settings.discount
        inputs = signature.observation.size + signature.desired_goal.size
        low = settings.precision == "bfloat16"
        drawn = torch.Generator().manual_seed(seeds.child("weights").integer())
        self.policy = MLP(Shape((inputs, *settings.hidden, 2 * actions), low=low), drawn, device)
        self.critic = MLP(
            Shape((inputs + actions, *settings.hidden, 1), members=2, layer_norm=settings.layer_norm, low=low),
            drawn,
            device,
        )
        self.target = self.critic.copy()
        self.normaliser = Normaliser(inputs, device)
        self.log_temperature = torch.full((1,), math.log(settings.temperature), device=self.device)
        self._optimisers = {
            "policy": Adam(self.policy.leaf, settings.learning_rate),
            "critic": Adam(self.critic.leaf, settings.learning_rate),
            "temperature": Adam(self.log_temperature, settings.learning_rate),
        }
        self._generator = torch.Generator(self.device).manual_seed(seeds.child("noise").integer())
        self._target_entropy = -float(actions) if settings.target_entropy is None else settings.target_entropy
        self._least_log_temperature = math.log(settings.temperature_min) if settings.temperature_min else -math.inf
        self._bounds = value_bounds(signature, settings.discount, clip=settings.clip_targets)

    @torch.inference_mode()
    def act(self, observation: FloatArray, desired_goal: FloatArray, *, explore: bool) -> FloatArray:
        """Actions (n, a) in [-1, 1] for observations (n, o) and goals (n, g)."""
        head = self.policy(acting_inputs(observation, desired_goal, self.normaliser, self.device), exact=True)
        if not explore:
            return to_array(mode(head))
        action = sample(head, self._generator).action
        return to_array(some_random(action, self.settings.random_actions, self._generator))

    def learn(self, batch: Batch) -> Mapping[str, Any]:
        """One update of critics, policy, temperature and targets, in this order; metrics as tensors."""
        inputs = learning_inputs(batch, self.normaliser, self.device)
        metrics = self._learn_critic(inputs)
        metrics |= self._learn_policy(inputs)
        self.target.follow(self.critic, self.settings.tau)
        return metrics

    @torch.no_grad()
    def _targets(self, inputs: Inputs) -> Tensor:
        """What the critics should say: (n,)."""
        action, log_probability = sample(self.policy(inputs.there), self._generator)
        value = self.target(torch.cat((inputs.there, action), 1)).squeeze(-1).amin(0)
        if self.settings.entropy_in_target:
            value = value - self.log_temperature.exp() * log_probability
        target = torch.addcmul(inputs.reward, inputs.discount, value)
        return target.clamp_(*self._bounds)

    def _learn_critic(self, inputs: Inputs) -> dict[str, Any]:
        targets = self._targets(inputs)
        values = self.critic(torch.cat((inputs.here, inputs.action), 1), learn=True).squeeze(-1)
        errors = values - targets
        loss = (inputs.weight * errors.square()).mean(1).sum()
        self._optimisers["critic"].step(loss)
        values, errors = values.detach(), errors.detach()
        return {
            "critic_loss": loss.detach(),
            "value_mean": values.mean(),
            "value_max": values.max(),
            "priorities": errors.abs().amax(0),
        }

    def _learn_policy(self, inputs: Inputs) -> dict[str, Any]:
        action, log_probability = sample(self.policy(inputs.here, learn=True), self._generator)
        value = self.critic(torch.cat((inputs.here, action), 1)).squeeze(-1).amin(0)
        temperature = self.log_temperature.exp()
        loss = (inputs.weight * (temperature * log_probability - value)).mean()
        self._optimisers["policy"].step(loss)
        entropy = -log_probability.detach().mean()
        self._learn_temperature(entropy)
        return {
            "policy_loss": loss.detach(),
            "entropy": entropy,
            "temperature": temperature.squeeze(0),
            "action_saturation": saturation(action),
        }

    def _learn_temperature(self, entropy: Tensor) -> None:
        """Raise the temperature while the policy's entropy is under its target. The gradient is written down."""
        self._optimisers["temperature"].step_along((entropy - self._target_entropy).view(1))
        self.log_temperature.clamp_(min=self._least_log_temperature)

    def state(self) -> State:
        """Everything that learning and acting depend on."""
        return {
            "policy": self.policy.state(),
            "critic": self.critic.state(),
            "target": self.target.state(),
            "normaliser": self.normaliser.state(),
            "log_temperature": self.log_temperature.clone(),
            "optimisers": {name: optimiser.state() for name, optimiser in self._optimisers.items()},
            "generator": self._generator.get_state(),
        }

    def load_state(self, state: State) -> None:
        """Raises UsageError when the state is of networks of another shape."""
        for name in ("policy", "critic", "target", "normaliser"):
            getattr(self, name).load_state(state[name])
        self.log_temperature.copy_(torch.as_tensor(state["log_temperature"]))
        for name, optimiser in self._optimisers.items():
            optimiser.load_state(state["optimisers"][name])
        self._generator.set_state(torch.as_tensor(state["generator"]))
