"""A small actor-critic in plain PyTorch: two networks, their losses, and autograd."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field as Setting
from torch import Tensor, nn

from karolos.agents import Normaliser
from karolos.core import Agent, AgentSettings, Batch, Discrete, FloatArray, Signature, State
from karolos.core.seeding import SeedTree
from karolos.errors import UsageError


class ActorCritic(Agent):
    """A deterministic policy, and a critic whose value of the policy's actions it maximises.

    Off-policy, continuous actions in [-1, 1]. Source: Lillicrap et al. 2015, arXiv 1509.02971 (DDPG).

    Raises:
        UsageError: the environment takes discrete actions.
    """

    class Settings(AgentSettings):
        learning_rate: float = Setting(1e-3, gt=0, description="of both networks (Adam)")
        discount: float = Setting(0.95, ge=0, lt=1, description="per environment step; about 1 - 1 / steps of episode")
        hidden: int = Setting(128, ge=1, description="units of each of the two hidden layers")
        tau: float = Setting(0.05, gt=0, le=1, description="step of the target networks per update (Polyak averaging)")
        noise: float = Setting(0.3, ge=0, description="standard deviation of the noise on exploring actions")

    on_policy: ClassVar[bool] = False
    networks: ClassVar[tuple[str, ...]] = ("policy", "critic", "target_policy", "target_critic")
    learned: ClassVar[tuple[str, ...]] = (*networks, "normaliser")
    shaping: ClassVar[tuple[str, ...]] = ("hidden",)

    def __init__(
        self, settings: ActorCritic.Settings, signature: Signature, seeds: SeedTree, device: str = "cpu"
    ) -> None:
        if isinstance(signature.action, Discrete):
            raise UsageError("actor_critic gives continuous actions", setting="agent", hint="choose another agent")
        self.settings, self.device, self.discount = settings, torch.device(device), settings.discount
        self.seen = signature.observation.acting.size  # the columns behind them are for critics alone
        inputs, actions = self.seen + signature.desired_goal.size, signature.action.size
        self.normaliser = Normaliser(inputs, device)  # observations and goals arrive in metres, radians, newtons
        generator = torch.Generator().manual_seed(seeds.child("weights").integer())
        self.policy = nn.Sequential(network((inputs, settings.hidden, actions), generator), nn.Tanh()).to(device)
        self.critic = network((inputs + actions, settings.hidden, 1), generator).to(device)
        self.target_policy, self.target_critic = deepcopy(self.policy), deepcopy(self.critic)
        self.optimisers = {
            "policy": torch.optim.Adam(self.policy.parameters(), settings.learning_rate, fused=True),
            "critic": torch.optim.Adam(self.critic.parameters(), settings.learning_rate, fused=True),
        }
        self.generator = torch.Generator().manual_seed(seeds.child("noise").integer())

    @torch.no_grad()
    def act(
        self,
        observation: FloatArray,
        desired_goal: FloatArray,
        *,
        explore: bool,
        environments: NDArray[np.int64] | None = None,  # noqa: ARG002 (each step explores independently)
    ) -> FloatArray:
        action = self.policy(self._inputs(observation, desired_goal)).cpu()
        if explore:
            noise = torch.randn(action.shape, generator=self.generator)
            action = (action + self.settings.noise * noise).clamp(-1, 1)
        return action.numpy()

    def learn(self, batch: Batch) -> Mapping[str, Any]:
        self.normaliser.update(self._tensor(batch.observation[..., : self.seen], batch.desired_goal))
        inputs = self._inputs(batch.observation, batch.desired_goal)
        next_inputs = self._inputs(batch.next_observation, batch.desired_goal)
        action, reward, weight = (self._tensor(array) for array in (batch.action, batch.reward, batch.weight))
        discount = self._tensor(batch.discount * (1 - batch.terminated))

        with torch.no_grad():
            target = reward + discount * value(self.target_critic, next_inputs, self.target_policy(next_inputs))
        error = value(self.critic, inputs, action) - target
        critic_loss = (weight * error.square()).mean()
        self._step("critic", critic_loss)

        policy_loss = -(weight * value(self.critic, inputs, self.policy(inputs))).mean()
        self._step("policy", policy_loss)

        with torch.no_grad():
            for target_network, network_ in ((self.target_policy, self.policy), (self.target_critic, self.critic)):
                for old, new in zip(target_network.parameters(), network_.parameters(), strict=True):
                    old.lerp_(new, self.settings.tau)
        return {
            "critic_loss": critic_loss.detach(),
            "policy_loss": policy_loss.detach(),
            "value_mean": (error.detach() + target).mean(),
            "priorities": error.detach().abs(),
        }

    def _step(self, name: str, loss: Tensor) -> None:
        self.optimisers[name].zero_grad()
        loss.backward(inputs=list(getattr(self, name).parameters()))
        self.optimisers[name].step()

    def _inputs(self, observation: FloatArray, desired_goal: FloatArray) -> Tensor:
        return self.normaliser(self._tensor(observation[..., : self.seen], desired_goal))

    def _tensor(self, *columns: FloatArray) -> Tensor:
        return torch.from_numpy(np.concatenate(columns, -1, dtype=np.float32)).to(self.device)

    def state(self) -> State:
        return deepcopy(
            {
                **{name: dict(getattr(self, name).state_dict()) for name in self.networks},
                "normaliser": self.normaliser.state(),
                "optimisers": {name: optimiser.state_dict()["state"] for name, optimiser in self.optimisers.items()},
                "generator": self.generator.get_state(),
            }
        )

    def load_state(self, state: State) -> None:
        self.normaliser.load_state(state["normaliser"])
        for name in self.networks:
            try:
                getattr(self, name).load_state_dict(state[name])
            except RuntimeError as error:
                raise UsageError("the stored networks have another shape", setting="agent") from error
        for name, optimiser in self.optimisers.items():
            optimiser.load_state_dict({**optimiser.state_dict(), "state": state["optimisers"][name]})
        self.generator.set_state(torch.as_tensor(state["generator"]))


def network(sizes: tuple[int, int, int], generator: torch.Generator) -> nn.Sequential:
    """Two hidden layers; the weights come from the generator, never from torch's global one."""
    inputs, hidden, outputs = sizes
    layers = nn.Sequential(
        nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU(), nn.Linear(hidden, outputs)
    )
    with torch.no_grad():
        for layer in layers:
            if isinstance(layer, nn.Linear):
                bound = layer.in_features**-0.5
                layer.weight.uniform_(-bound, bound, generator=generator)
                layer.bias.uniform_(-bound, bound, generator=generator)
    return layers


def value(critic: nn.Module, inputs: Tensor, action: Tensor) -> Tensor:
    """Q(s, a), (n,)."""
    return critic(torch.cat((inputs, action), 1)).squeeze(1)
