"""Deep Q-learning (Mnih et al. 2015) with double Q (van Hasselt et al. 2016) and an optional dueling network."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal, Self

import torch
from numpy import int64
from numpy.typing import NDArray
from pydantic import Field as Setting
from pydantic import model_validator
from torch import Tensor

from ..core import Batch, Deployed, Discrete, SeedTree, Signature
from ..core.schedules import Linear
from ..errors import UsageError
from .device import Precision, uses_bfloat16
from .inputs import TensorBatch
from .networks import MLP, NetworkShape
from .optimisation import Metrics, report
from .torch_agent import Hidden, OptimiserSettings, TorchAgent, value_bounds


class DQN(TorchAgent):
    """A network that predicts the value of each discrete action. The policy takes the action with the largest value.

    Off-policy. Exploring actions are uniform with probability epsilon, sampled for each environment. Epsilon falls with
    the environment steps in which the agent explored. Observations and goals are normalised by running
    statistics of the batches.

    Raises:
        UsageError: the environment takes continuous actions.
    """

    class Settings(OptimiserSettings):
        learning_rate: float = Setting(3e-4, gt=0, description="learning rate of the network (Adam)")
        discount: float = Setting(
            0.99, ge=0, lt=1, description="factor per environment step; about 1 - 1 / steps of episode"
        )
        hidden: Hidden = Setting((256, 256), description="units of each hidden layer")
        double_q: bool = Setting(True, description="the online network chooses the next action, not the target network")
        dueling: bool = Setting(False, description="separate outputs for the state's value and the actions' advantages")
        tau: float = Setting(0.005, gt=0, le=1, description="step of the target network each time it is updated")
        target_interval: int = Setting(
            1, ge=1, description="updates of the network per update of the target network; tau: 1 copies it"
        )
        epsilon_start: float = Setting(1.0, ge=0, le=1, description="share of random exploring actions at the start")
        epsilon_end: float = Setting(0.05, ge=0, le=1, description="share of random exploring actions at the end")
        epsilon_steps: int = Setting(5_000, ge=0, description="exploring environment steps until epsilon_end, linearly")
        loss: Literal["huber", "squared"] = Setting("huber", description="huber: linear for errors above 1")
        layer_norm: bool = Setting(False, description="layer normalisation: steadier, a little slower")
        clip_targets: bool = Setting(
            True, description="clip targets to the values that the declared reward range allows"
        )
        precision: Precision = Setting(
            "float32", description="for matrix products while learning; the values of actions often differ by 1 %"
        )

        @model_validator(mode="after")
        def _epsilon_falls(self) -> Self:
            if self.epsilon_end > self.epsilon_start:
                raise ValueError(f"epsilon_end {self.epsilon_end} is above epsilon_start {self.epsilon_start}")
            return self

    on_policy: ClassVar[bool] = False
    shaping: ClassVar[tuple[str, ...]] = ("hidden", "fine_goal", "layer_norm", "dueling")
    learned: ClassVar[tuple[str, ...]] = ("network", "target", "normaliser")
    stored: tuple[str, ...] = (*learned, "explored", "updates")

    def __init__(self, settings: DQN.Settings, signature: Signature, seeds: SeedTree, device: str = "cpu") -> None:
        if not isinstance(signature.action, Discrete):
            raise UsageError(
                f"dqn chooses one of a set of discrete actions, and this environment takes {signature.action.size} "
                "continuous numbers",
                setting="agent",
                hint="a robot has such a set with environment.actions=discrete; elsewhere choose sac, td3, ddpg or ppo",
            )
        self._actions = len(signature.action.labels)
        super().__init__(settings, signature, seeds, device)
        shape = NetworkShape(
            (self.inputs, *settings.hidden, self._actions + settings.dueling),
            layer_norm=settings.layer_norm,
            bfloat16=uses_bfloat16(settings.precision, device),
        )
        self.network = MLP(shape, self.weights_generator, device)
        self.target = self.network.copy()
        self.optimisers = {"network": self.adam(self.network.vector)}
        self._bounds = value_bounds(signature, settings.discount, clip=settings.clip_targets)
        self._schedule = Linear(settings.epsilon_start, settings.epsilon_end, settings.epsilon_steps)
        self.explored = 0
        self.updates = 0

    @property
    def epsilon(self) -> float:
        """Current probability of a random exploring action."""
        return self._schedule(self.explored)

    def best(self, inputs: Tensor) -> Tensor:
        """Indices of actions (n, 1), as whole float32 numbers."""
        return self._values(self.network(inputs, exact=True)).argmax(1, keepdim=True).float()

    def explore(self, inputs: Tensor, environments: NDArray[int64] | None) -> Tensor:  # noqa: ARG002 (interface)
        best, epsilon = self.best(inputs), self.epsilon
        is_random = torch.rand(best.shape, generator=self.generator, device=self.device) < epsilon
        drawn = torch.randint(self._actions, best.shape, generator=self.generator, device=self.device)
        self.explored += len(best)
        return torch.where(is_random, drawn.float(), best)

    @torch.inference_mode()
    def learn(self, batch: Batch) -> Mapping[str, Any]:
        """One update of the network, and in every `target_interval`-th update of the target network."""
        update = self.updates
        data = self.begin_update(batch, update)
        self.updates += 1

        targets = self.targets(data)
        index = data.action.long()  # floats hold every index exactly
        output, tapes = self.network.forward(data.input)
        values = self._values(output).gather(1, index).squeeze(1)
        errors, huber = values - targets, self.settings.loss == "huber"
        gradient = errors.clamp(-1, 1) if huber else 2 * errors

        def value_loss() -> Tensor:
            """The weighted sum of u^2 over the errors u, or of huber(u) = u^2 / 2 where |u| <= 1, else |u| - 1/2."""
            return torch.dot(data.weight, gradient * (errors - gradient / 2) if huber else errors.square())

        self.network.backward(self._output_gradient(output, index, data.weight * gradient), tapes)
        self.optimisers["network"].step(self.network.gradient)
        if self.updates % self.settings.target_interval == 0:
            self.target.follow(self.network, self.settings.tau)
        metrics: Metrics = {
            "priorities": errors.abs(),
            "value_loss": value_loss,
            "value_mean": values.mean,
            "value_max": values.max,
            "target_mean": targets.mean,
            "gradient_norm": self.optimisers["network"].gradient_norm,
            "epsilon": lambda: torch.tensor(self.epsilon),
            "learning_rate": lambda: torch.tensor(self.settings.rate(update)),
        }
        return report(metrics, {}, update)

    def targets(self, batch: TensorBatch) -> Tensor:
        """y = r + discount Q'(s', argmax_a Q(s', a)), clipped to the possible values: (n,).

        Source: van Hasselt et al. 2016, equation 4. Without `double_q` Q' chooses the action too.
        """
        target_values = self._values(self.target(batch.next_input))
        choosing = self._values(self.network(batch.next_input)) if self.settings.double_q else target_values
        value = target_values.gather(1, choosing.argmax(1, keepdim=True)).squeeze(1)
        return torch.addcmul(batch.reward, batch.discount, value).clamp_(*self._bounds)

    def _values(self, output: Tensor) -> Tensor:
        """The value of each action from the network's output: (n, actions).

        Dueling: Q = V + A - mean A (Wang et al. 2016, equation 9), with V in the first column.
        """
        if not self.settings.dueling:
            return output
        state, advantages = output[:, :1], output[:, 1:]
        return state + advantages - advantages.mean(1, keepdim=True)

    def _output_gradient(self, output: Tensor, index: Tensor, gradient: Tensor) -> Tensor:
        """The gradient by the network's output from `gradient`, (n,), by the values of the actions `index`, (n, 1)."""
        column = gradient.unsqueeze(1)
        if not self.settings.dueling:
            return torch.zeros_like(output).scatter_(1, index, column)
        by_output = (column / -self._actions).repeat(1, output.shape[1])  # through the mean of the advantages
        by_output[:, :1] = column
        return by_output.scatter_add_(1, index + 1, column)

    def deployed(self) -> Deployed:
        """The action with the largest value. In a dueling network it has the largest advantage, too."""
        return self.policy_arrays(self.network, "argmax", slice(int(self.settings.dueling), None))
