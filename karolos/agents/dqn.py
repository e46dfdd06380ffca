"""Deep Q-learning (Mnih et al. 2015) with double Q (van Hasselt et al. 2016) and an optional dueling head."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import torch
from numpy import int64
from numpy.typing import NDArray
from pydantic import Field as Setting
from pydantic import model_validator
from torch import Tensor

from ..core import Agent, Batch, Discrete, FloatArray, Signature, State
from ..core.deployed import Deployed
from ..core.schedules import Linear
from ..core.seeding import SeedTree
from ..errors import UsageError
from .actor_critic import WATCHED_EVERY
from .cuda_graphs import GraphedUpdates
from .deployment import deployed
from .device import Precision, is_low
from .inputs import Fed, Inputs, acting_inputs, feed, is_observed, normalised, to_array, value_bounds
from .networks import MLP, Shape
from .normaliser import Normaliser
from .optimisation import Adam, OptimiserSettings


class DQN(Agent):
    """A network that gives each discrete action a value, and takes the action of the largest.

    Off-policy. The target of a transition is what the target network says of the action that the online network prefers
    there (double Q). Exploring actions are uniform with probability epsilon, drawn for each environment on its own;
    epsilon falls with the environment steps in which the agent explored. Observations and goals are normalised by
    running statistics of what was learned from.

    With `dueling` the last layer gives one value of the state and an advantage of each action, of which the mean is
    taken off (Wang et al. 2016, equation 9); the hidden layers are shared.

    Raises:
        UsageError: the environment takes continuous actions.
    """

    class Settings(OptimiserSettings):
        learning_rate: float = Setting(3e-4, gt=0, description="of the network (Adam)")
        discount: float = Setting(0.99, ge=0, lt=1, description="per environment step; about 1 - 1 / steps of episode")
        hidden: tuple[int, ...] = Setting((256, 256), min_length=1, description="units of each hidden layer")
        double_q: bool = Setting(True, description="the online network chooses the action in targets, not the target's")
        dueling: bool = Setting(False, description="value of the state and advantages of actions apart")
        tau: float = Setting(0.005, gt=0, le=1, description="share of the network that its target takes when it moves")
        target_interval: int = Setting(1, ge=1, description="updates between two moves of the target; tau: 1 copies")
        epsilon_start: float = Setting(1.0, ge=0, le=1, description="share of random exploring actions at the start")
        epsilon_end: float = Setting(0.05, ge=0, le=1, description="and when it has fallen")
        epsilon_steps: int = Setting(5_000, ge=0, description="exploring environment steps over which it falls evenly")
        loss: Literal["huber", "squared"] = Setting("huber", description="huber: linear for errors above 1")
        layer_norm: bool = Setting(False, description="layer-normalised network: steadier, a little slower")
        clip_targets: bool = Setting(True, description="cut targets to what the declared reward range makes possible")
        precision: Precision = Setting(
            "float32", description="of the wide products while learning; the values of actions often differ by 1 %"
        )

        @model_validator(mode="after")
        def _epsilon_falls(self) -> DQN.Settings:
            if self.epsilon_end > self.epsilon_start:
                raise ValueError(f"epsilon_end {self.epsilon_end} is above epsilon_start {self.epsilon_start}")
            return self

    on_policy: ClassVar[bool] = False
    learned: ClassVar[tuple[str, ...]] = ("network", "target", "normaliser")

    def __init__(self, settings: DQN.Settings, signature: Signature, seeds: SeedTree, device: str = "cpu") -> None:
        self._actions = _require_discrete(signature)
        self.settings, self.device, self.discount = settings, torch.device(device), settings.discount
        inputs = signature.observation.size + signature.desired_goal.size
        shape = Shape(
            (inputs, *settings.hidden, self._actions + settings.dueling),
            layer_norm=settings.layer_norm,
            low=is_low(settings.precision, device),
        )
        self.network = MLP(shape, torch.Generator().manual_seed(seeds.child("weights").integer()), device)
        self.target = self.network.copy()
        self.normaliser = Normaliser(inputs, device)
        self._optimiser = Adam(self.network.vector, settings.rate, norm=settings.gradient_norm)
        self._generator = torch.Generator(self.device).manual_seed(seeds.child("noise").integer())
        self._bounds = value_bounds(signature, settings.discount, clip=settings.clip_targets)
        self._schedule = Linear(settings.epsilon_start, settings.epsilon_end, settings.epsilon_steps)
        self._graphed = GraphedUpdates(self.device, (self.network, self.target), self._generator)
        self._explored = 0
        self._updates = 0

    @property
    def epsilon(self) -> float:
        """Share of exploring actions that are random now."""
        return self._schedule(self._explored)

    @torch.inference_mode()
    def act(
        self,
        observation: FloatArray,
        desired_goal: FloatArray,
        *,
        explore: bool,
        environments: NDArray[int64] | None = None,  # noqa: ARG002 (epsilon remembers nothing)
    ) -> FloatArray:
        """Indices of actions (n, 1), whole float32 numbers, for observations (n, o) and goals (n, g)."""
        rows = acting_inputs(observation, desired_goal, self.normaliser, self.device)
        action = self._values(self.network(rows, exact=True)).argmax(1)
        if explore:
            size, epsilon = action.shape, self.epsilon
            at_random = torch.rand(size, generator=self._generator, device=self.device) < epsilon
            drawn = torch.randint(self._actions, size, generator=self._generator, device=self.device)
            action = torch.where(at_random, drawn, action)
            self._explored += len(action)
        return to_array(action.float().unsqueeze(1))

    def _values(self, head: Tensor) -> Tensor:
        """What the network gives out as a value of each action: (n, actions)."""
        if not self.settings.dueling:
            return head
        state, advantages = head[:, :1], head[:, 1:]
        return state + advantages - advantages.mean(1, keepdim=True)

    @torch.inference_mode()
    def learn(self, batch: Batch) -> Mapping[str, Any]:
        """One update of the network, and of its target when it is its turn; now and then metrics, as tensors."""
        watch, observe = self._updates % WATCHED_EVERY == 0, is_observed(self._updates)
        self._updates += 1
        follow = self._updates % self.settings.target_interval == 0
        self._optimiser.begin()

        def work(fed: Fed) -> dict[str, Any]:
            return self._update(normalised(fed, self.normaliser, observe=observe), watch=watch, follow=follow)

        metrics = self._graphed.run((watch, observe, follow), feed(batch), work)
        if watch:
            metrics["epsilon"] = torch.tensor(self.epsilon)
        return metrics | self._optimiser.rate_watched(watch=watch)

    def _update(self, inputs: Inputs, *, watch: bool, follow: bool) -> dict[str, Any]:
        """Gradients are written down, as in SAC. `GraphedUpdates` says what an update may do."""
        targets = self.targets(inputs)
        index = inputs.action.long()  # floats hold every index exactly
        head, tapes = self.network.forward(inputs.here)
        values = self._values(head).gather(1, index).squeeze(1)
        errors = values - targets
        slope = errors.clamp(-1, 1) if self.settings.loss == "huber" else 2 * errors
        self.network.backward(self._head_gradient(head, index, inputs.share * slope), tapes)
        length = self._optimiser.move(self.network.gradient, "gradient_norm", watch=watch)
        if follow:
            self.target.follow(self.network, self.settings.tau)
        if not watch:
            return {"priorities": errors.abs_()}
        each = slope * (errors - slope / 2) if self.settings.loss == "huber" else errors.square()
        return {
            **length,
            "value_loss": torch.dot(inputs.share, each),
            "value_mean": values.mean(),
            "value_max": values.max(),
            "target_mean": targets.mean(),
            "priorities": errors.abs(),
        }

    def _head_gradient(self, head: Tensor, index: Tensor, pull: Tensor) -> Tensor:
        """The gradient of the network's outputs from that of the values of the actions taken.

        Args:
            head: the outputs, (n, columns).
            index: the actions taken, (n, 1).
            pull: the gradient of their values, (n,).
        """
        column = pull.unsqueeze(1)
        if not self.settings.dueling:
            return torch.zeros_like(head).scatter_(1, index, column)
        found = (column / -self._actions).repeat(1, head.shape[1])  # each advantage lowers the mean
        found[:, :1] = column
        return found.scatter_add_(1, index + 1, column)

    def targets(self, inputs: Inputs) -> Tensor:
        """What the network should say of the actions taken: (n,)."""
        there = self._values(self.target(inputs.there))
        choosing = self._values(self.network(inputs.there)) if self.settings.double_q else there
        value = there.gather(1, choosing.argmax(1, keepdim=True)).squeeze(1)
        return torch.addcmul(inputs.reward, inputs.discount, value).clamp_(*self._bounds)

    def deployed(self) -> Deployed:
        """The action of the largest value; with a dueling head of the largest advantage, which is the same."""
        return deployed(self.network, self.normaliser, "argmax", columns=slice(int(self.settings.dueling), None))

    def state(self) -> State:
        """Everything that learning and acting depend on."""
        return {
            "network": self.network.state(),
            "target": self.target.state(),
            "normaliser": self.normaliser.state(),
            "optimiser": self._optimiser.state(),
            "generator": self._generator.get_state(),
            "explored": self._explored,
            "updates": self._updates,
        }

    def load_state(self, state: State) -> None:
        """Raises UsageError when the state is of a network of another shape."""
        for name in ("network", "target", "normaliser"):
            getattr(self, name).load_state(state[name])
        self._optimiser.load_state(state["optimiser"])
        self._generator.set_state(torch.as_tensor(state["generator"]))
        self._explored = int(state["explored"])
        self._updates = int(state["updates"])


def _require_discrete(signature: Signature) -> int:
    """How many actions there are. Raises UsageError where actions are continuous."""
    if isinstance(signature.action, Discrete):
        return len(signature.action.labels)
    raise UsageError(
        f"dqn chooses one of a set of discrete actions, and this environment takes {signature.action.size} "
        "continuous numbers",
        where="agent",
        hint="a robot has such a set with environment.actions=discrete; elsewhere choose sac, td3, ddpg or ppo",
    )
