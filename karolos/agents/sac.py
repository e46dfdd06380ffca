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
from ..core.deployed import Deployed
from ..core.seeding import SeedTree
from .actor_critic import (
    WATCHED_EVERY,
    ActorCriticSettings,
    critic_metrics,
    imitation_loss,
    load_parts,
    parts_state,
    squared_loss,
)
from .chain import Tape
from .cuda_graphs import GraphedUpdates
from .deployment import deployed
from .device import is_low
from .inputs import (
    Fed,
    Inputs,
    acting_inputs,
    feed,
    is_observed,
    normalised,
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
from .squashed_gaussian import Sample, head_gradient, log_probability, mode, sample

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
        policy_delay: int = Setting(1, ge=1, description="critic updates for each update of policy and temperature")
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
            "policy": Adam(self.policy.vector, settings.rate, norm=settings.gradient_norm),
            "critic": Adam(self.critic.vector, settings.rate, norm=settings.gradient_norm),
            "temperature": Adam(self.log_temperature, settings.rate),
        }
        self.generator = torch.Generator(self.device).manual_seed(seeds.child("noise").integer())
        self._graphed = GraphedUpdates(self.device, (self.policy, self.critic, self.target), self.generator)
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

    @torch.inference_mode()
    def learn(self, batch: Batch) -> Mapping[str, Any]:
        """One update of critics, policy, temperature and targets, in this order; now and then metrics, as tensors."""
        delay = self.settings.policy_delay
        update = self.optimisers["critic"].steps
        watch, observe, policy = update % (WATCHED_EVERY * delay) == 0, is_observed(update), update % delay == 0
        for name, optimiser in self.optimisers.items():
            if policy or name == "critic":
                optimiser.begin()

        def work(fed: Fed) -> dict[str, Any]:
            return self._update(normalised(fed, self.normaliser, observe=observe), watch=watch, policy=policy)

        metrics = self._graphed.run((watch, observe, policy), feed(batch), work)
        return metrics | self.optimisers["critic"].rate_watched(watch=watch)

    def _update(self, inputs: Inputs, *, watch: bool, policy: bool) -> dict[str, Any]:
        """Gradients are written down: autograd takes as long for a loss of 256 numbers as a product of two layers does.

        `GraphedUpdates` says what an update may do.
        """
        if not policy:
            metrics = self._learn_critic(inputs, self._draw(inputs.there)[0], watch=watch)
        else:
            drawn, tapes = self._draw(inputs.observed)  # for both ends of the transitions: the policy changes after
            metrics = self._learn_critic(inputs, drawn, watch=watch)
            count = len(inputs.action)
            here = [tape.rows(count, count) for tape in tapes]
            metrics |= self._learn_policy(inputs, drawn.rows(count), here, watch=watch)
        self.target.follow(self.critic, self.settings.tau)
        return metrics

    def _draw(self, rows: Tensor) -> tuple[Sample, list[Tape]]:
        """Actions of the policy, and the way back from them."""
        head, tapes = self.policy.forward(rows)
        noise = torch.randn((len(rows), head.shape[1] // 2), generator=self.generator, device=self.device)
        return sample(head, noise), tapes

    def targets(self, inputs: Inputs, following: Sample) -> Tensor:
        """What the critics should say: (n,), or (n, k) samples of it where they give quantiles.

        Args:
            inputs: the batch.
            following: actions where its transitions lead; further rows are ignored.
        """
        count, critic = len(inputs.action), self.settings.critic
        values = self.target(torch.cat((inputs.there, following.action[:count]), 1))
        value = truncated(values, critic.drop) if critic else values.squeeze(-1).amin(0).unsqueeze(1)
        if self.settings.entropy_in_target:
            value = value - (self.log_temperature.exp() * log_probability(following)[:count]).unsqueeze(1)
        target = torch.addcmul(inputs.reward.unsqueeze(1), inputs.discount.unsqueeze(1), value).clamp_(*self._bounds)
        return target if critic else target.squeeze(1)

    def _learn_critic(self, inputs: Inputs, following: Sample, *, watch: bool) -> dict[str, Any]:
        targets = self.targets(inputs, following)
        values, tapes = self.critic.forward(torch.cat((inputs.here, inputs.action), 1))
        loss_of = quantile_huber if self.settings.critic else squared_loss
        loss, slope = loss_of(values, targets, inputs.share)
        self.critic.backward(slope, tapes)
        length = self.optimisers["critic"].move(self.critic.gradient, "critic_gradient_norm", watch=watch)
        if self.settings.critic:
            return critic_metrics(loss, values.mean(-1), targets.mean(-1), watch=watch) | length
        return critic_metrics(loss, values.squeeze(-1), targets, watch=watch) | length

    def _value(self, values: Tensor) -> Tensor:
        """What the policy takes from the critics' outputs: the smaller value, or the mean of all quantiles. (n,)."""
        return values.mean((0, 2)) if self.settings.critic else values.squeeze(-1).amin(0)

    def _value_gradient(self, values: Tensor, value: Tensor, pull: Tensor) -> Tensor:
        """The gradient of the critics' outputs from that of `_value`, (n,)."""
        if self.settings.critic:
            return (pull / (values.shape[0] * values.shape[2])).view(1, -1, 1).expand_as(values)
        return (values == value.unsqueeze(1)) * pull.unsqueeze(1)

    def _learn_policy(self, inputs: Inputs, drawn: Sample, tapes: list[Tape], *, watch: bool) -> dict[str, Any]:
        settings, share, action = self.settings, inputs.share, drawn.action
        temperature = self.log_temperature.exp()
        log_probabilities = log_probability(drawn)
        values, critic_tapes = self.critic.forward(torch.cat((inputs.here, action), 1))
        value = self._value(values)
        for_action = self.critic.backward(
            self._value_gradient(values, value, -share),
            critic_tapes,
            parameters=False,
            columns=slice(inputs.observed.shape[1], None),
        )
        assert for_action is not None
        if settings.action_penalty:
            for_action.add_(action, alpha=2 * settings.action_penalty / action.numel())
        for_head = head_gradient(drawn, for_action, temperature * share)
        metrics: dict[str, Any] = {}
        if settings.imitation and inputs.demonstrated is not None:
            middle = torch.tanh(drawn.unbounded - drawn.shift)
            shown, own = (self._value(self.critic(torch.cat((inputs.here, a), 1))) for a in (inputs.action, middle))
            distance, for_middle = imitation_loss(middle, shown > own, inputs)
            for_head[:, : middle.shape[1]] += settings.imitation * for_middle * (1 - middle.square())
            metrics["imitation_loss"] = distance
        self.policy.backward(for_head, tapes)
        metrics |= self.optimisers["policy"].move(self.policy.gradient, "policy_gradient_norm", watch=watch)
        entropy = -log_probabilities.mean()
        self._learn_temperature(entropy)
        if not watch:
            return metrics
        return {
            **metrics,
            "policy_loss": torch.dot(share, temperature * log_probabilities - value),
            "entropy": entropy,
            "temperature": temperature.squeeze(0),
            "action_saturation": saturation(action),
        }

    def _learn_temperature(self, entropy: Tensor) -> None:
        """Raise the temperature while the policy's entropy is under its target. The gradient is written down."""
        pull = (entropy - self._target_entropy).view(1)
        self.optimisers["temperature"].move(pull)
        if self.settings.temperature_min:
            self.log_temperature.clamp_(min=self._least_log_temperature)

    def deployed(self) -> Deployed:
        """The mean of the policy, squashed."""
        columns = self.policy.shape.sizes[-1] // 2  # the others are the log spread
        return deployed(self.policy, self.normaliser, "tanh", columns=slice(columns))

    def state(self) -> State:
        """Everything that learning and acting depend on."""
        return {**parts_state(self, PARTS), "log_temperature": self.log_temperature.clone()}

    def load_state(self, state: State) -> None:
        """Raises UsageError when the state is of networks of another shape."""
        load_parts(self, PARTS, state)
        self.log_temperature.copy_(torch.as_tensor(state["log_temperature"]))
