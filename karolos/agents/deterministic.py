"""What DDPG and TD3 share: a deterministic policy, critics of its actions, and targets of both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import torch
from pydantic import Field as Setting
from torch import Tensor

from ..core import Batch, FloatArray, Signature, State
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


class DeterministicSettings(BaseSettings):
    """Settings of every agent with a deterministic policy."""

    learning_rate: float = Setting(1e-3, gt=0, description="of policy and critics (Adam)")
    discount: float = Setting(0.95, ge=0, lt=1, description="per environment step; about 1 - 1 / steps of episode")
    hidden: tuple[int, ...] = Setting((256, 256), min_length=1, description="units of each hidden layer")
    tau: float = Setting(0.05, gt=0, le=1, description="share of the networks that their targets take per update")
    noise: float = Setting(0.2, ge=0, description="standard deviation of the Gaussian noise on exploring actions")
    random_actions: float = Setting(0.3, ge=0, le=1, description="share of exploring actions drawn uniformly")
    action_penalty: float = Setting(0.0, ge=0, description="weight of the mean squared action in the policy's loss")
    layer_norm: bool = Setting(False, description="layer-normalised critics: steadier, a little slower")
    clip_targets: bool = Setting(True, description="cut targets to what the declared reward range makes possible")
    precision: Literal["float32", "bfloat16"] = Setting(
        "bfloat16", description="of the wide products while learning; sums, inputs and outputs stay float32"
    )


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


class Deterministic:
    """Networks, exploration and updates of an agent with a deterministic policy.

    Args:
        settings: shared settings.
        variant: the algorithm.
        signature: of the environments.
        seeds: the agent's node of the tree.
        device: where the networks live.

    Raises:
        UsageError: the environment takes discrete actions.
    """

    def __init__(
        self, settings: DeterministicSettings, variant: Variant, signature: Signature, seeds: SeedTree, device: str
    ) -> None:
        actions = require_continuous(signature, variant.name)
        self.settings, self.variant, self.device = settings, variant, torch.device(device)
        inputs = signature.observation.size + signature.desired_goal.size
        low = settings.precision == "bfloat16"
        drawn = torch.Generator().manual_seed(seeds.child("weights").integer())
        self.policy = MLP(Shape((inputs, *settings.hidden, actions), low=low), drawn, device)
        sizes = (inputs + actions, *settings.hidden, 1)
        self.critic = MLP(Shape(sizes, members=variant.critics, layer_norm=settings.layer_norm, low=low), drawn, device)
        self.target_policy, self.target = self.policy.copy(), self.critic.copy()
        self.normaliser = Normaliser(inputs, device)
        self._optimisers = {
            "policy": Adam(self.policy.leaf, settings.learning_rate),
            "critic": Adam(self.critic.leaf, settings.learning_rate),
        }
        self._generator = torch.Generator(self.device).manual_seed(seeds.child("noise").integer())
        self._bounds = value_bounds(signature, settings.discount, clip=settings.clip_targets)
        self._updates = 0

    @torch.inference_mode()
    def act(self, observation: FloatArray, desired_goal: FloatArray, *, explore: bool) -> FloatArray:
        """Actions (n, a) in [-1, 1] for observations (n, o) and goals (n, g)."""
        rows = acting_inputs(observation, desired_goal, self.normaliser, self.device)
        action = torch.tanh(self.policy(rows, exact=True))
        if not explore:
            return to_array(action)
        noise = torch.randn(action.shape, generator=self._generator, device=self.device)
        noisy = torch.add(action, noise, alpha=self.settings.noise).clamp_(-1, 1)
        return to_array(some_random(noisy, self.settings.random_actions, self._generator))

    def learn(self, batch: Batch) -> Mapping[str, Any]:
        """One update of the critics, and of policy and targets when it is their turn; metrics as tensors."""
        inputs = learning_inputs(batch, self.normaliser, self.device)
        metrics = self._learn_critic(inputs)
        self._updates += 1
        if self._updates % self.variant.policy_delay == 0:
            metrics |= self._learn_policy(inputs)
            self.target.follow(self.critic, self.settings.tau)
            self.target_policy.follow(self.policy, self.settings.tau)
        return metrics

    @torch.no_grad()
    def targets(self, inputs: Inputs) -> Tensor:
        """What the critics should say: (n,)."""
        action = torch.tanh(self.target_policy(inputs.there))
        if self.variant.target_noise:
            noise = torch.randn(action.shape, generator=self._generator, device=self.device)
            clip = self.variant.noise_clip
            action = (action + noise.mul_(self.variant.target_noise).clamp_(-clip, clip)).clamp_(-1, 1)
        value = self.target(torch.cat((inputs.there, action), 1)).squeeze(-1).amin(0)
        return torch.addcmul(inputs.reward, inputs.discount, value).clamp_(*self._bounds)

    def _learn_critic(self, inputs: Inputs) -> dict[str, Any]:
        targets = self.targets(inputs)
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
        action = torch.tanh(self.policy(inputs.here, learn=True))
        value = self.critic(torch.cat((inputs.here, action), 1)).squeeze(-1)[0]
        loss = (-inputs.weight * value).mean() + self.settings.action_penalty * action.square().mean()
        self._optimisers["policy"].step(loss)
        return {"policy_loss": loss.detach(), "action_saturation": saturation(action)}

    def state(self) -> State:
        """Everything that learning and acting depend on."""
        return {
            "policy": self.policy.state(),
            "critic": self.critic.state(),
            "target_policy": self.target_policy.state(),
            "target": self.target.state(),
            "normaliser": self.normaliser.state(),
            "optimisers": {name: optimiser.state() for name, optimiser in self._optimisers.items()},
            "generator": self._generator.get_state(),
            "updates": self._updates,
        }

    def load_state(self, state: State) -> None:
        """Raises UsageError when the state is of networks of another shape."""
        for name in ("policy", "critic", "target_policy", "target", "normaliser"):
            getattr(self, name).load_state(state[name])
        for name, optimiser in self._optimisers.items():
            optimiser.load_state(state["optimisers"][name])
        self._generator.set_state(torch.as_tensor(state["generator"]))
        self._updates = int(state["updates"])
