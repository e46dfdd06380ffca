"""Proximal policy optimisation (Schulman et al. 2017, arXiv 1707.06347).

Gradients are written down: with autograd a run of pendulum_ppo takes 30 to 40 % more CPU time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import chain
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field as Setting
from torch import Tensor

from ..core import Buffer, Deployed, Discrete, FloatArray, Rollout, SeedTree, Signature, State
from ..errors import UsageError
from .inputs import Normaliser
from .networks import MLP, NetworkShape, array_of
from .optimisation import learning_rates, saturation
from .squashed_gaussian import LOG_STD_BOUNDS
from .torch_agent import Hidden, OptimiserSettings, TorchAgent

PPO_INPUT_CLIP = 10.0
"""Bound of normalised inputs. Better policies reach states far from the first ones, e.g. a cart far from the middle.
Source: OpenAI baselines, VecNormalize (clipob)."""
KL_SLACK = 1.5
"""Learning from a rollout ends when the policy has moved this many times `target_kl`. Source: OpenAI Spinning Up."""
RELU_GAIN = 2**0.5
"""Keeps the variance of activations through rectifiers. Source: He et al. 2015."""


class RolloutBatch(NamedTuple):
    """The transitions of a rollout on the device: (n, ...)."""

    inputs: Tensor
    action: Tensor
    log_probability: Tensor
    """Log probability of the action under the policy that collected it."""
    advantage: Tensor
    value: Tensor
    """Value by the network before it learns from the rollout."""
    target: Tensor
    """Target of the value: advantage + value."""


class PPO(TorchAgent[Rollout]):
    """Improves the policy on its latest rollout, and keeps it near the policy that collected the rollout.

    On-policy; continuous actions (a Gaussian whose actions are stored unclipped) and discrete ones. Observations and
    goals are normalised by running statistics. These change only between rollouts. From the first step of a rollout to
    its last update the same weights therefore mean the same policy.
    """

    class Settings(OptimiserSettings):
        discount: float = Setting(
            0.95, ge=0, lt=1, description="factor per environment step; about 1 - 1 / steps of episode"
        )
        trace_decay: float = Setting(
            0.95, ge=0, le=1, description="lambda of advantages; 0 relies on values, 1 on rewards"
        )
        clip: float = Setting(0.2, gt=0, description="largest distance of the probability ratio from 1")
        value_clip: float | None = Setting(
            None, gt=0, description="largest change of a value per rollout, in spreads of the returns; null: unlimited"
        )
        entropy: float = Setting(0.0, ge=0, description="weight of the policy's entropy (nats)")
        epochs: int = Setting(10, ge=1, le=10_000, description="passes through each rollout")
        minibatches: int = Setting(
            8, ge=1, le=10**6, description="gradient updates per epoch, each from a share of the rollout"
        )
        target_kl: float | None = Setting(
            None,
            gt=0,
            description="stop learning from a rollout when the KL divergence exceeds 1.5 times this; null: never",
        )
        gradient_norm: float | None = Setting(0.5, gt=0, description="clip gradients to this norm; null: no clipping")
        hidden: Hidden = Setting((64, 64), description="units of each hidden layer")
        std: float = Setting(1.0, gt=0, description="initial standard deviation of continuous actions")

    on_policy: ClassVar[bool] = True
    shaping: ClassVar[tuple[str, ...]] = ("hidden", "fine_goal")
    learned: ClassVar[tuple[str, ...]] = ("policy", "distribution", "value", "normaliser")
    stored = learned

    def __init__(self, settings: PPO.Settings, signature: Signature, seeds: SeedTree, device: str = "cpu") -> None:
        super().__init__(settings, signature, seeds, device, input_clip=PPO_INPUT_CLIP)
        generator = self.weights_generator
        self.distribution: Gaussian | Categorical
        if isinstance(signature.action, Discrete):
            self.distribution = Categorical(len(signature.action.labels))
        else:
            self.distribution = Gaussian(signature.action.size, settings.std, device)
        self.policy = MLP(NetworkShape((self.inputs, *settings.hidden, self.distribution.columns)), generator, device)
        make_orthogonal(self.policy, generator, last_gain=0.01)
        self.value = Value((self.inputs, *settings.hidden), generator, device)
        vectors = {"policy": self.policy.vector, "value": self.value.network.vector}
        if isinstance(self.distribution, Gaussian):
            vectors["std"] = self.distribution.log_std
        self.optimisers = {name: self.adam(vector, epsilon=1e-5) for name, vector in vectors.items()}

    def best(self, inputs: Tensor) -> Tensor:
        return self.distribution.mode(self.policy(inputs))

    def explore(self, inputs: Tensor, environments: NDArray[np.int64] | None) -> Tensor:  # noqa: ARG002 (interface)
        """Unclipped actions."""
        return self.distribution.sample(self.policy(inputs), self.generator)

    @torch.inference_mode()
    def learn(self, batch: Rollout) -> Mapping[str, Any]:
        """`epochs` passes through the rollout of `minibatches` updates each; metrics are means over the updates."""
        transitions, settings = self._transitions(batch), self.settings
        count = len(transitions.action)
        # Every epoch uses each transition once, in another order. A rollout is shorter if simulations diverged.
        orders = (
            torch.randperm(count, generator=self.generator, device=self.device).tensor_split(
                min(settings.minibatches, count)
            )
            for _ in range(settings.epochs)
        )
        updates: list[dict[str, Tensor]] = []
        for chosen in chain.from_iterable(orders):
            metrics = self.update(RolloutBatch(*(field[chosen] for field in transitions)))
            if metrics is None:
                break
            updates.append(metrics)
        self.normaliser.update(self.unscaled(batch.observation[batch.stored], batch.desired_goal[batch.stored]))

        unexplained = (transitions.target - transitions.value).var(correction=0)
        total = transitions.target.var(correction=0)
        means = {name: torch.stack([metrics[name] for metrics in updates]).mean() for name in updates[0]}
        means |= learning_rates(self.optimisers)
        if isinstance(self.distribution, Gaussian):
            means["action_saturation"] = saturation(transitions.action)
            means["std"] = self.distribution.log_std.exp().mean()
        return {
            **means,
            "explained_variance": torch.where(total > 0, 1 - unexplained / total, torch.zeros_like(total)),
            "value_mean": transitions.value.mean(),
            "updates": len(updates),
        }

    def update(self, minibatch: RolloutBatch) -> dict[str, Tensor] | None:
        """One gradient step of policy and value. Returns None and makes no step if the policy has moved too far.

        The policy's loss is L = - mean min(ratio A, clip(ratio, 1 - clip, 1 + clip) A) - entropy mean H, with the
        normalised advantages A. Source: Schulman et al. 2017, equations 7 and 9.
        """
        settings = self.settings
        output, tapes = self.policy.forward(minibatch.inputs)
        log_ratio = self.distribution.log_probability(output, minibatch.action) - minibatch.log_probability
        ratio = log_ratio.exp()
        kl = (ratio - 1 - log_ratio).mean()  # http://joschu.net/blog/kl-approx.html, k3
        if settings.target_kl is not None and float(kl) > KL_SLACK * settings.target_kl:
            return None
        advantage = minibatch.advantage - minibatch.advantage.mean()
        advantage = advantage / (minibatch.advantage.std(correction=0) + 1e-8)

        unclipped, clipped = ratio * advantage, ratio.clamp(1 - settings.clip, 1 + settings.clip) * advantage
        # d ratio / d log p = ratio; the clipped term has no gradient where it is the smaller one.
        gradient = torch.where(unclipped <= clipped, unclipped, 0) / -len(ratio)
        by_output = self.distribution.backward(output, minibatch.action, gradient, -settings.entropy / len(ratio))
        entropy = self.distribution.entropy(output).mean()
        self.policy.backward(by_output, tapes)
        for optimiser in self.optimisers.values():
            optimiser.learning_rate = settings.rate(self.optimisers["value"].steps)
        self.optimisers["policy"].step(self.policy.gradient)
        if isinstance(self.distribution, Gaussian):
            self.optimisers["std"].step(self.distribution.gradient)
            self.distribution.log_std.clamp_(*LOG_STD_BOUNDS)

        value_loss = self.value.backward(minibatch.inputs, minibatch.target, minibatch.value, settings.value_clip)
        self.optimisers["value"].step(self.value.network.gradient)
        return {
            "policy_loss": -torch.minimum(unclipped, clipped).mean(),
            "value_loss": value_loss,
            "gradient_norm": self.optimisers["policy"].gradient_norm(),
            "value_gradient_norm": self.optimisers["value"].gradient_norm(),
            "kl": kl,
            "clip_fraction": ((ratio - 1).abs() > settings.clip).float().mean(),
            "entropy": entropy,
        }

    def _transitions(self, rollout: Rollout) -> RolloutBatch:
        """The stored transitions, with advantages, values and log probabilities before learning from them."""
        stored = torch.from_numpy(rollout.stored.ravel()).to(self.device)
        inputs = self.network_input(rollout.observation, rollout.desired_goal)
        next_inputs = self.network_input(rollout.next_observation, rollout.desired_goal)
        values, next_values = (
            array_of(self.value(rows)).reshape(rollout.reward.shape) for rows in (inputs, next_inputs)
        )
        discount, trace_decay = self.settings.discount, self.settings.trace_decay
        estimated = advantages(rollout, values, next_values, discount=discount, trace_decay=trace_decay)
        action, value, advantage = (
            torch.from_numpy(array.reshape(len(inputs), *array.shape[2:])).to(self.device)[stored]
            for array in (rollout.action, values, estimated)
        )
        inputs = inputs[stored]
        log_probability = self.distribution.log_probability(self.policy(inputs), action)
        target = advantage + value
        self.value.update_scale(target)
        return RolloutBatch(inputs, action, log_probability, advantage, value, target)

    def check(self, buffer: Buffer[Any], *, demonstrations: bool) -> None:
        """Raise a UsageError if a rollout has fewer transitions than there are minibatches."""
        super().check(buffer, demonstrations=demonstrations)
        if buffer.capacity is not None and buffer.capacity < self.settings.minibatches:
            raise UsageError(
                f"a rollout of {buffer.capacity} transitions cannot be split into {self.settings.minibatches} "
                "minibatches",
                setting="agent.minibatches",
                hint="raise buffer.rollout, or lower agent.minibatches",
            )

    def deployed(self) -> Deployed:
        """The mean action, clipped to [-1, 1], or the most likely discrete one."""
        return self.policy_arrays(self.policy, "clip" if isinstance(self.distribution, Gaussian) else "argmax")


def advantages(
    rollout: Rollout, value: FloatArray, next_value: FloatArray, *, discount: float, trace_decay: float
) -> FloatArray:
    """Generalised advantage estimates, (T, n); 0 where no transition is stored.

    A_t = d_t + discount trace_decay A_(t+1), with d_t = r_t + discount V(s_(t+1)) - V(s_t). After a terminated step the
    next value is 0; the sum ends with each episode and with the rollout. Source: Schulman et al. 2016, arXiv
    1506.02438, equation 16.

    Args:
        value: of the observations, (T, n).
        next_value: of the next observations, (T, n).
        trace_decay: lambda; 0 trusts the values, 1 the rewards.
    """
    next_value = np.where(rollout.terminated, np.float32(0), next_value)
    error = np.where(rollout.stored, rollout.reward + np.float32(discount) * next_value - value, np.float32(0))
    decay = np.where(rollout.ended, np.float32(0), np.float32(discount * trace_decay))
    estimates = np.zeros_like(error)
    following = np.zeros_like(error[0])
    for step in reversed(range(len(estimates))):
        following = estimates[step] = error[step] + decay[step] * following
    return estimates


class Gaussian:
    """Continuous actions around the network's output, with a standard deviation that is independent of the input.

    Samples are unbounded. Environments receive them clipped to [-1, 1]; probabilities are those of the unclipped ones.

    Args:
        columns: of an action, and of the network's output.
        std: standard deviation at the start.
    """

    def __init__(self, columns: int, std: float, device: str) -> None:
        self.columns = columns
        self.log_std = torch.full((columns,), math.log(std), device=device)
        """The learned parameters, (a,). Change them in place."""
        self.gradient = torch.zeros_like(self.log_std)
        """Gradient by `log_std`; result of the latest `backward`."""

    def sample(self, output: Tensor, generator: torch.Generator) -> Tensor:
        """Exploring actions (n, a) from the network's output (n, columns)."""
        noise = torch.randn(output.shape, generator=generator, device=output.device)
        return torch.addcmul(output, self.log_std.exp(), noise)

    def mode(self, output: Tensor) -> Tensor:
        """The actions without exploration, (n, a)."""
        return output.clamp(-1, 1)

    def log_probability(self, output: Tensor, action: Tensor) -> Tensor:
        """Log probability of the actions (n, a), a density for continuous ones: (n,)."""
        distance = (action - output) * torch.exp(-self.log_std)
        constant = 0.5 * math.log(2 * math.pi) * self.columns
        return -(distance.square().mul(0.5) + self.log_std).sum(-1) - constant

    def entropy(self, output: Tensor) -> Tensor:
        """Entropy in nats: (n,)."""
        entropy = self.log_std.sum() + 0.5 * self.columns * (1 + math.log(2 * math.pi))
        return entropy.expand(len(output))

    def backward(self, output: Tensor, action: Tensor, by_log_probability: Tensor, by_entropy: float) -> Tensor:
        """The gradient by the network's output (n, columns), from those by log probabilities (n,) and by each entropy.

        `gradient` holds the gradient by `log_std`. With d = (action - output) / std: d log p / d output = d / std,
        d log p / d log std = d^2 - 1, and d entropy / d log std = 1.
        """
        inverse, column = torch.exp(-self.log_std), by_log_probability.unsqueeze(-1)
        distance = (action - output) * inverse
        torch.sum((distance.square() - 1).mul_(column), 0, out=self.gradient)
        self.gradient.add_(by_entropy * len(output))
        return distance.mul_(column).mul_(inverse)

    def state(self) -> State:
        return {"log_std": self.log_std.clone()}

    def load_state(self, state: State) -> None:
        self.log_std.copy_(torch.as_tensor(state["log_std"]))


class Categorical:
    """One of `columns` discrete actions, an index (n, 1) as a float, by the softmax of the network's output.

    Its methods are those of `Gaussian`; the network holds all parameters.
    """

    def __init__(self, columns: int) -> None:
        self.columns = columns

    def sample(self, output: Tensor, generator: torch.Generator) -> Tensor:
        return torch.multinomial(torch.softmax(output, -1), 1, generator=generator).float()

    def mode(self, output: Tensor) -> Tensor:
        return output.argmax(-1, keepdim=True).float()

    def log_probability(self, output: Tensor, action: Tensor) -> Tensor:
        return torch.log_softmax(output, -1).gather(-1, action.long()).squeeze(-1)

    def entropy(self, output: Tensor) -> Tensor:
        log_probability = torch.log_softmax(output, -1)
        return -(log_probability.exp() * log_probability).sum(-1)

    def backward(self, output: Tensor, action: Tensor, by_log_probability: Tensor, by_entropy: float) -> Tensor:
        """As `Gaussian.backward`. With p = softmax(output) and entropy H: d log p_a / d output_j = (j = a) - p_j,
        d H / d output_j = -p_j (log p_j + H).
        """
        log_probability, column = torch.log_softmax(output, -1), by_log_probability.unsqueeze(-1)
        probability = log_probability.exp()
        entropy = -(probability * log_probability).sum(-1, keepdim=True)
        gradient = (log_probability + entropy).mul_(-by_entropy).sub_(column).mul_(probability)
        return gradient.scatter_add_(-1, action.long(), column)

    def state(self) -> State:
        return {}

    def load_state(self, state: State) -> None:
        pass


class Value:
    """A value network whose output is scaled by mean and standard deviation of the returns.

    Returns of -1000 are then learned as fast as returns of 1. When mean and standard deviation change, the last layer
    is changed so that all values stay the same (PopArt, van Hasselt et al. 2016, arXiv 1602.07714).

    Args:
        sizes: input columns, units of each hidden layer.
    """

    def __init__(self, sizes: tuple[int, ...], generator: torch.Generator, device: str) -> None:
        self.network = MLP(NetworkShape((*sizes, 1)), generator, device)
        make_orthogonal(self.network, generator, last_gain=1.0)
        self._returns = Normaliser(1, device)

    def _scale(self) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation of the returns so far: float32, (1,) each."""
        return self._returns.mean.float(), self._returns.spread.float()

    def __call__(self, inputs: Tensor) -> Tensor:
        """Values (n,) of normalised inputs (n, i)."""
        mean, spread = self._scale()
        return torch.addcmul(mean, self.network(inputs).squeeze(-1), spread)

    def update_scale(self, returns: Tensor) -> None:
        """Add returns (n,) to mean and standard deviation; values stay the same."""
        mean, spread = self._scale()
        self._returns.update(returns.unsqueeze(1))
        new_mean, new_spread = self._scale()
        last = len(self.network.shape.sizes) - 2
        weight, bias = (self.network.named[f"layer{last}.{part}"] for part in ("weight", "bias"))
        weight.mul_(spread / new_spread)
        bias.mul_(spread).add_(mean - new_mean).div_(new_spread)

    def backward(self, inputs: Tensor, target: Tensor, old_value: Tensor, clip: float | None) -> Tensor:
        """L = mean max((V - y)^2, (V_c - y)^2) / 2 with V_c = V_old + clip(V - V_old, -clip, clip).

        Values and targets are in units of the returns' standard deviation. Without `clip`: mean (V - y)^2 / 2. It
        leaves the network's gradient. Source: Schulman et al. 2017, equation 9; the clipping is that of OpenAI
        baselines, ppo2.

        Args:
            inputs: (n, i).
            target: y, (n,).
            old_value: V_old, (n,).
            clip: largest change of a value; None: unlimited.
        """
        mean, spread = self._scale()
        output, tapes = self.network.forward(inputs)
        value, target = output.squeeze(-1), (target - mean) / spread
        gradient = value - target
        error = gradient.square()
        if clip is not None:
            old_value = (old_value - mean) / spread
            change = value - old_value
            # Within the range V_c is V itself: old_value + change often differs from it in the last digit.
            near = torch.where(change.abs() <= clip, value, old_value + change.clamp(-clip, clip))
            clipped = (near - target).square()
            gradient = gradient * (error >= clipped)  # V_c is constant where its error is the larger one
            error = torch.maximum(error, clipped)
        self.network.backward((gradient / len(value)).unsqueeze(-1), tapes)
        return 0.5 * error.mean()

    def state(self) -> State:
        return {"network": self.network.state(), "returns": self._returns.state()}

    def load_state(self, state: State) -> None:
        """Load a state. Raises UsageError if it belongs to a network of another shape."""
        self.network.load_state(state["network"])
        self._returns.load_state(state["returns"])


def make_orthogonal(network: MLP, generator: torch.Generator, *, last_gain: float) -> None:
    """Set orthogonal weights (Saxe et al. 2014) and zero biases.

    Args:
        network: one without members.
        last_gain: of the last layer; small, it makes the outputs start near 0. The other layers have sqrt(2).
    """
    weights = [view for name, view in network.named.items() if name.endswith("weight")]
    network.vector.zero_()
    for number, view in enumerate(weights, 1):
        gain = last_gain if number == len(weights) else RELU_GAIN
        view.copy_(torch.nn.init.orthogonal_(torch.empty(view.shape), gain, generator=generator))
