"""Proximal policy optimisation (Schulman et al. 2017, arXiv 1707.06347)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field as Setting
from torch import Tensor

from ..core import Agent, Discrete, FloatArray, Rollout, Signature, State
from ..core.deployed import Deployed
from ..core.seeding import SeedTree
from ..errors import UsageError
from .advantages import advantages
from .categorical import Categorical
from .deployment import deployed
from .gaussian import Gaussian
from .inputs import acting_inputs, saturation, to_array
from .networks import MLP, Shape
from .normaliser import Normaliser
from .optimisation import Adam, OptimiserSettings
from .orthogonal import make_orthogonal
from .value import Value

CLIP = 10.0
"""Normalised inputs are cut here: what a better policy reaches lies outside of what the first ones saw, e.g. a cart far
from the middle. Source: OpenAI baselines, VecNormalize (clipob); 5 is what hindsight agents take."""
KL_SLACK = 1.5
"""A rollout is done with when the policy has moved this many times `target_kl`. Source: OpenAI Spinning Up, ppo."""


class _Taken(NamedTuple):
    """The transitions of a rollout on the device: (n, ...)."""

    inputs: Tensor
    action: Tensor
    log_probability: Tensor
    """Of the action under the policy that took it."""
    advantage: Tensor
    value: Tensor
    target: Tensor
    """What the value should have been: advantage + value."""

    def rows(self, chosen: Tensor) -> _Taken:
        return _Taken(*(field[chosen] for field in self))


class PPO(Agent[Rollout]):
    """Improves the policy on what it has just played, as long as it stays near the policy that played it.

    On-policy; continuous actions (a Gaussian, neither squashed nor stored clipped) and discrete ones. Observations and
    goals are normalised by running statistics, which change between rollouts only: while one is collected and learned
    from, the same policy is meant by the same weights.
    """

    class Settings(OptimiserSettings):
        discount: float = Setting(0.95, ge=0, lt=1, description="per environment step; about 1 - 1 / steps of episode")
        trace_decay: float = Setting(0.95, ge=0, le=1, description="lambda of advantages: 0 trusts values, 1 rewards")
        clip: float = Setting(0.2, gt=0, description="how far from 1 the ratio of probabilities is worth moving")
        value_clip: float | None = Setting(
            None, gt=0, description="how far a value may move per rollout, in spreads of the returns; null: any way"
        )
        entropy: float = Setting(0.0, ge=0, description="weight of the policy's entropy (nats)")
        epochs: int = Setting(10, ge=1, description="how often each transition is learned from")
        minibatches: int = Setting(8, ge=1, description="gradient updates per epoch, each from a share of the rollout")
        target_kl: float | None = Setting(
            None, gt=0, description="stop learning from a rollout once the policy has moved 1.5 times this; null: never"
        )
        gradient_norm: float | None = Setting(0.5, gt=0, description="longer gradients are cut to this; null: never")
        hidden: tuple[int, ...] = Setting((64, 64), min_length=1, description="units of each hidden layer")
        std: float = Setting(1.0, gt=0, description="spread of continuous actions at the start")

    on_policy: ClassVar[bool] = True
    learned: ClassVar[tuple[str, ...]] = ("policy", "distribution", "value", "normaliser")

    def __init__(self, settings: PPO.Settings, signature: Signature, seeds: SeedTree, device: str = "cpu") -> None:
        self.settings, self.device, self.discount = settings, torch.device(device), settings.discount
        inputs = signature.observation.size + signature.desired_goal.size
        drawn = torch.Generator().manual_seed(seeds.child("weights").integer())
        self.distribution: Gaussian | Categorical
        if isinstance(signature.action, Discrete):
            self.distribution = Categorical(len(signature.action.labels))
        else:
            self.distribution = Gaussian(signature.action.size, settings.std, device)
        self.policy = MLP(Shape((inputs, *settings.hidden, self.distribution.columns)), drawn, device)
        make_orthogonal(self.policy, drawn, last_gain=0.01)
        self.value = Value((inputs, *settings.hidden), drawn, device)
        self.normaliser = Normaliser(inputs, device, clip=CLIP)
        learned = {"policy": self.policy.vector, "value": self.value.network.vector}
        if isinstance(self.distribution, Gaussian):
            learned["std"] = self.distribution.log_std
        self._optimisers = {
            name: Adam(vector, settings.rate, epsilon=1e-5, norm=settings.gradient_norm)
            for name, vector in learned.items()
        }
        self._generator = torch.Generator(self.device).manual_seed(seeds.child("noise").integer())

    @torch.inference_mode()
    def act(
        self,
        observation: FloatArray,
        desired_goal: FloatArray,
        *,
        explore: bool,
        environments: NDArray[np.int64] | None = None,  # noqa: ARG002 (exploration remembers nothing)
    ) -> FloatArray:
        """Actions (n, a) for observations (n, o) and goals (n, g): in [-1, 1], or exploring and not clipped."""
        head = self.policy(acting_inputs(observation, desired_goal, self.normaliser, self.device))
        if explore:
            return to_array(self.distribution.sample(head, self._generator))
        return to_array(self.distribution.mode(head))

    @torch.inference_mode()
    def learn(self, batch: Rollout) -> Mapping[str, Any]:
        """`epochs` times through the rollout in `minibatches` updates each; metrics are means over the updates.

        Raises:
            UsageError: the rollout has fewer transitions than there are minibatches.
        """
        taken = self._taken(batch)
        updates: list[dict[str, Tensor]] = []
        for rows in self._minibatches(len(taken.action)):
            metrics = self._update(taken.rows(rows))
            if metrics is None:
                break
            updates.append(metrics)
        self._observe(batch)
        means = {name: torch.stack([metrics[name] for metrics in updates]).mean() for name in updates[0]}
        return means | self._of_rollout(taken) | {"updates": len(updates)}

    def _taken(self, rollout: Rollout) -> _Taken:
        """The rollout with what policy and value say of it before they learn from it."""
        size = rollout.reward.shape
        stored = torch.from_numpy(rollout.stored.ravel()).to(self.device)
        here, there = (self._rows(rollout, name) for name in ("observation", "next_observation"))
        value, next_value = (to_array(self.value(inputs)).reshape(size) for inputs in (here, there))
        settings = self.settings
        advantage = advantages(rollout, value, next_value, discount=settings.discount, trace_decay=settings.trace_decay)
        inputs, action, worth, better = (
            tensor[stored]
            for tensor in (
                here,
                torch.from_numpy(rollout.action.reshape(len(here), -1)).to(self.device),
                torch.from_numpy(value.ravel()).to(self.device),
                torch.from_numpy(advantage.ravel()).to(self.device),
            )
        )
        log_probability = self.distribution.log_probability(self.policy(inputs), action)
        target = better + worth
        self.value.fit_scale(target)
        return _Taken(inputs, action, log_probability, better, worth, target)

    def _rows(self, rollout: Rollout, name: str) -> Tensor:
        """Observations of all transitions beside their goals, normalised: (T n, o + g)."""
        observation, goal = getattr(rollout, name), rollout.desired_goal
        count = rollout.reward.size
        return acting_inputs(
            observation.reshape(count, observation.shape[-1]),
            goal.reshape(count, goal.shape[-1]),
            self.normaliser,
            self.device,
        )

    def _minibatches(self, count: int) -> Iterator[Tensor]:
        """Rows of each update: every epoch takes all of them once, in an order of its own."""
        if count < self.settings.minibatches:
            raise UsageError(
                f"a rollout of {count} transitions cannot be split into {self.settings.minibatches} minibatches",
                where="agent.minibatches",
                hint="raise buffer.rollout, or lower agent.minibatches",
            )
        for _ in range(self.settings.epochs):
            order = torch.randperm(count, generator=self._generator, device=self.device)
            yield from order.tensor_split(self.settings.minibatches)

    def _update(self, taken: _Taken) -> dict[str, Tensor] | None:
        """One gradient update of policy and value; None if the policy has moved too far already.

        Gradients are written down, as in SAC.
        """
        settings, count = self.settings, len(taken.inputs)
        head, tapes = self.policy.forward(taken.inputs)
        difference = self.distribution.log_probability(head, taken.action) - taken.log_probability
        ratio = difference.exp()
        moved = (ratio - 1 - difference).mean()  # http://joschu.net/blog/kl-approx.html, k3
        if settings.target_kl is not None and float(moved) > KL_SLACK * settings.target_kl:
            return None
        advantage = taken.advantage - taken.advantage.mean()
        advantage = advantage / (taken.advantage.std(correction=0) + 1e-8)
        free, clipped = ratio * advantage, ratio.clamp(1 - settings.clip, 1 + settings.clip) * advantage
        gain = torch.minimum(free, clipped).mean()
        entropy = self.distribution.entropy(head).mean()
        # d ratio / d log p = ratio; the clipped gain is the smaller one only where it does not move
        for_log_probability = torch.where(free <= clipped, free, 0) / -count
        weight = -settings.entropy / count
        for_head = self.distribution.backward(head, taken.action, for_log_probability, weight)
        self.policy.backward(for_head, tapes)
        policy_norm = self._optimisers["policy"].step(self.policy.gradient)
        if isinstance(self.distribution, Gaussian):
            self._optimisers["std"].step(self.distribution.gradient)
            self.distribution.keep_bounds()
        value_loss = self.value.learn(taken.inputs, taken.target, taken.value, settings.value_clip)
        value_norm = self._optimisers["value"].step(self.value.network.gradient)
        return {
            "policy_loss": -gain,
            "value_loss": value_loss,
            "kl": moved,
            "clip_fraction": ((ratio - 1).abs() > settings.clip).float().mean(),
            "entropy": entropy,
            "gradient_norm": policy_norm,
            "value_gradient_norm": value_norm,
        }

    def _of_rollout(self, taken: _Taken) -> dict[str, Tensor]:
        """What can be said of a rollout as a whole."""
        left, whole = (taken.target - taken.value).var(correction=0), taken.target.var(correction=0)
        found = {
            "explained_variance": torch.where(whole > 0, 1 - left / whole, torch.zeros_like(whole)),
            "value_mean": taken.value.mean(),
            **self._optimisers["policy"].rate_watched(watch=True),
        }
        if isinstance(self.distribution, Gaussian):
            found |= {"action_saturation": saturation(taken.action), "std": self.distribution.log_std.exp().mean()}
        return found

    def _observe(self, rollout: Rollout) -> None:
        """Take what the rollout observed into the statistics that inputs are normalised by."""
        rows = torch.from_numpy(np.concatenate((rollout.observation, rollout.desired_goal), -1)[rollout.stored])
        self.normaliser.update(rows.to(self.device))

    def deployed(self) -> Deployed:
        """The mean action, cut to [-1, 1], or the likeliest of a discrete set."""
        return deployed(self.policy, self.normaliser, "clip" if isinstance(self.distribution, Gaussian) else "argmax")

    def state(self) -> State:
        """Everything that learning and acting depend on."""
        return {
            "policy": self.policy.state(),
            "distribution": self.distribution.state(),
            "value": self.value.state(),
            "normaliser": self.normaliser.state(),
            "optimisers": {name: optimiser.state() for name, optimiser in self._optimisers.items()},
            "generator": self._generator.get_state(),
        }

    def load_state(self, state: State) -> None:
        """Raises UsageError when the state is of networks of another shape."""
        for name in self.learned:
            getattr(self, name).load_state(state[name])
        for name, optimiser in self._optimisers.items():
            optimiser.load_state(state["optimisers"][name])
        self._generator.set_state(torch.as_tensor(state["generator"]))
