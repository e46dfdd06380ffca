"""What DDPG and TD3 share: a deterministic policy, critics of its actions, and targets of both."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from numpy import int64
from numpy.typing import NDArray
from pydantic import Field as Setting
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
from .noise import Noise, ScaledNoiseSettings
from .normaliser import Normaliser
from .optimisation import Adam


class DeterministicSettings(ActorCriticSettings):
    """Settings of every agent with a deterministic policy."""

    noise: ScaledNoiseSettings = Setting(default_factory=ScaledNoiseSettings, description="on exploring actions")
    random_actions: float = Setting(0.3, ge=0, le=1, description="share of exploring actions drawn uniformly")


@dataclass(frozen=True)
class Variant:
    """What tells one algorithm from another.

    Args:
        name: of the agent.
        critics: how many; the smallest value counts in targets.
        target_noise: standard deviation of the noise on the next action in targets, clipped at `noise_clip`.
        noise_clip: largest such noise.
        policy_delay: critic updates for each update of policy and targets.
    """

    name: str
    critics: int = 1
    target_noise: float = 0.0
    noise_clip: float = 0.0
    policy_delay: int = 1


class Deterministic(Agent):
    """Networks, exploration and updates of an agent with a deterministic policy; which one, `variant_of` says.

    Raises:
        UsageError: the environment takes discrete actions.
    """

    on_policy: ClassVar[bool] = False
    learned: ClassVar[tuple[str, ...]] = ("policy", "critic", "target_policy", "target", "normaliser")

    def __init__(
        self, settings: DeterministicSettings, signature: Signature, seeds: SeedTree, device: str = "cpu"
    ) -> None:
        self.variant = variant = self.variant_of(settings)
        actions = require_continuous(signature, variant.name)
        self.settings, self.device, self.discount = settings, torch.device(device), settings.discount
        inputs = signature.observation.size + signature.desired_goal.size
        low = is_low(settings.precision, device)
        drawn = torch.Generator().manual_seed(seeds.child("weights").integer())
        self.policy = MLP(Shape((inputs, *settings.hidden, actions), low=low), drawn, device)
        sizes = (inputs + actions, *settings.hidden, 1)
        self.critic = MLP(Shape(sizes, members=variant.critics, layer_norm=settings.layer_norm, low=low), drawn, device)
        self.target_policy, self.target = self.policy.copy(), self.critic.copy()
        self.normaliser = Normaliser(inputs, device)
        self.noise = Noise(settings.noise, inputs, actions, self.device)
        self.optimisers = {
            "policy": Adam(self.policy.vector, settings.rate, norm=settings.gradient_norm),
            "critic": Adam(self.critic.vector, settings.rate, norm=settings.gradient_norm),
        }
        self.generator = torch.Generator(self.device).manual_seed(seeds.child("noise").integer())
        self._bounds = value_bounds(signature, settings.discount, clip=settings.clip_targets)
        self._updates = 0
        networks = (self.policy, self.critic, self.target_policy, self.target)
        self._graphed = GraphedUpdates(self.device, networks, self.generator)

    @staticmethod
    @abstractmethod
    def variant_of(settings: Any) -> Variant:
        """The algorithm with these settings."""

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
        action = torch.tanh(self.policy(rows, exact=True))
        if not explore:
            return to_array(action)
        noise = self.noise.draw(rows, self.generator, environments)
        noisy = torch.add(action, noise, alpha=self.settings.noise.std).clamp_(-1, 1)
        return to_array(some_random(noisy, self.settings.random_actions, self.generator))

    def begin_episodes(self, environments: NDArray[int64]) -> None:
        self.noise.begin(environments)

    @torch.inference_mode()
    def learn(self, batch: Batch) -> Mapping[str, Any]:
        """One update of the critics, and of policy and targets when it is their turn; metrics as in SAC."""
        observe, delay = is_observed(self._updates), self.variant.policy_delay
        watch = self._updates // delay % WATCHED_EVERY == 0
        self._updates += 1
        policy = self._updates % delay == 0
        self.optimisers["critic"].begin()
        if policy:
            self.optimisers["policy"].begin()

        def work(fed: Fed) -> dict[str, Any]:
            return self._update(normalised(fed, self.normaliser, observe=observe), watch=watch, policy=policy)

        metrics = self._graphed.run((watch, observe, policy), feed(batch), work)
        return metrics | self.optimisers["critic"].rate_watched(watch=watch)

    def _update(self, inputs: Inputs, *, watch: bool, policy: bool) -> dict[str, Any]:
        """`GraphedUpdates` says what it may do."""
        metrics = self._learn_critic(inputs, watch=watch)
        if policy:
            metrics |= self._learn_policy(inputs, watch=watch)
            self.target.follow(self.critic, self.settings.tau)
            self.target_policy.follow(self.policy, self.settings.tau)
        return metrics

    def targets(self, inputs: Inputs) -> Tensor:
        """What the critics should say: (n,)."""
        action = torch.tanh(self.target_policy(inputs.there))
        if self.variant.target_noise:
            noise = torch.randn(action.shape, generator=self.generator, device=self.device)
            clip = self.variant.noise_clip
            action = (action + noise.mul_(self.variant.target_noise).clamp_(-clip, clip)).clamp_(-1, 1)
        value = self.target(torch.cat((inputs.there, action), 1)).squeeze(-1).amin(0)
        return torch.addcmul(inputs.reward, inputs.discount, value).clamp_(*self._bounds)

    def _learn_critic(self, inputs: Inputs, *, watch: bool) -> dict[str, Any]:
        targets = self.targets(inputs)
        values, tapes = self.critic.forward(torch.cat((inputs.here, inputs.action), 1))
        loss, slope = squared_loss(values, targets, inputs.share)
        self.critic.backward(slope, tapes)
        length = self.optimisers["critic"].move(self.critic.gradient, "critic_gradient_norm", watch=watch)
        return critic_metrics(loss, values.squeeze(-1), targets, watch=watch) | length

    def _learn_policy(self, inputs: Inputs, *, watch: bool) -> dict[str, Any]:
        """Gradients are written down, as in SAC."""
        settings, share = self.settings, inputs.share
        head, tapes = self.policy.forward(inputs.here)
        action = torch.tanh(head)
        values, critic_tapes = self.critic.forward(torch.cat((inputs.here, action), 1), first=True)
        value, slope = values[0, :, 0], torch.zeros_like(values)
        slope[0, :, 0] = -share
        for_action = self.critic.backward(
            slope, critic_tapes, parameters=False, columns=slice(inputs.observed.shape[1], None)
        )
        assert for_action is not None
        metrics: dict[str, Any] = {}
        if watch:
            metrics |= {"policy_loss": -torch.dot(share, value), "action_saturation": saturation(action)}
        if settings.action_penalty:
            for_action.add_(action, alpha=2 * settings.action_penalty / action.numel())
        if settings.imitation and inputs.demonstrated is not None:
            shown = self.critic.forward(torch.cat((inputs.here, inputs.action), 1), first=True)[0][0, :, 0]
            metrics["imitation_loss"], for_shown = imitation_loss(action, shown > value, inputs)
            for_action.add_(for_shown, alpha=settings.imitation)
        self.policy.backward(for_action * (1 - action.square()), tapes)
        gradient, name = self.policy.gradient, "policy_gradient_norm"
        return metrics | self.optimisers["policy"].move(gradient, name, watch=watch)

    def deployed(self) -> Deployed:
        """The policy, squashed."""
        return deployed(self.policy, self.normaliser, "tanh")

    def state(self) -> State:
        """Everything that learning and acting depend on."""
        return {**parts_state(self, (*self.learned, "noise")), "updates": self._updates}

    def load_state(self, state: State) -> None:
        """Raises UsageError when the state is of networks of another shape."""
        load_parts(self, (*self.learned, "noise"), state)
        self._updates = int(state["updates"])
