"""The common part of SAC, DDPG and TD3: a policy of continuous actions, its critics, exploration, and their state."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, Self

import torch
from numpy import int64
from numpy.typing import NDArray
from pydantic import Field as Setting
from pydantic import model_validator
from torch import Tensor

from ..core import Buffer, Deployed, Discrete, SeedTree, Signature, State
from ..core import Settings as BaseSettings
from ..core.settings import LATER
from ..errors import UsageError
from .device import PRECISION_MEANS, Precision, uses_bfloat16
from .inputs import TensorBatch
from .joint_network import JointNetwork, JointShape
from .layers import Tape
from .networks import MLP, NetworkShape
from .noise import Noise
from .optimisation import Metrics
from .torch_agent import Hidden, OptimiserSettings, TorchAgent, joint_columns, value_bounds

GOLDEN = (5**0.5 - 1) / 2
"""The golden ratio, less 1."""


class ActorCriticSettings(OptimiserSettings):
    """Settings of every agent with a policy of continuous actions and critics."""

    discount: float = Setting(
        0.95, ge=0, lt=1, description="factor per environment step; about 1 - 1 / steps of episode"
    )
    hidden: Hidden = Setting((256, 256), description="units of each hidden layer")
    tau: float = Setting(0.05, gt=0, le=1, description="step of the target networks per update (Polyak averaging)")
    layer_norm: bool = Setting(False, description="layer normalisation in the critics: steadier, a little slower")
    clip_targets: bool = Setting(True, description="clip targets to the values that the declared reward range allows")
    action_penalty: float = Setting(0.0, ge=0, description="weight of the mean squared action in the policy loss")
    imitation: float = Setting(
        0.0,
        ge=0,
        description="weight of the squared distance to demonstrated actions, where the critics prefer these; with "
        "buffer.hindsight.imitate also to actions of relabelled transitions",
    )
    cloning: bool = Setting(
        False,
        description="behaviour cloning: the policy imitates all demonstrated actions and ignores the critics",
        json_schema_extra=LATER,
    )
    quiet: float = Setting(
        0.0,
        ge=0,
        le=1,
        description="share of the environments in which training acts without noise and without random actions; these "
        "episodes show how precise the policy is",
        json_schema_extra=LATER,
    )
    policy_average: float = Setting(
        1.0,
        gt=0,
        le=1,
        description="tests use a moving average of the policy: its step per policy update; 1: the policy itself",
    )
    per_joint: bool = Setting(
        False,
        json_schema_extra=LATER,
        description="networks that treat all joints alike, for policies of many arms: the first of `hidden` are units "
        "for each joint, the others for all; in float32; it needs robot.joint_slots",
    )
    precision: Precision = Setting("auto", description=PRECISION_MEANS)

    @model_validator(mode="after")
    def _settings_fit(self) -> Self:
        if self.cloning and not self.imitation:
            raise ValueError("cloning needs imitation above 0: this is the weight of the demonstrated actions")
        if self.per_joint and len(self.hidden) < 2:
            raise ValueError("per_joint needs two numbers in hidden: units for each joint, then units for all")
        return self


class Critic:
    """Critics whose outputs (members, n, columns) are values. The smallest one counts.

    Source: Fujimoto et al. 2018, equation 10.
    """

    columns = 1
    """Outputs of each network."""

    def target_values(self, outputs: Tensor) -> Tensor:
        """Values of the next state for the critics' targets: (n, k), ascending."""
        return outputs.amin(0)

    def loss(self, outputs: Tensor, targets: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
        """sum over members and rows of weight (Q - y)^2, and its gradient 2 weight (Q - y) by Q.

        Source: Fujimoto et al. 2018, algorithm 1; Haarnoja et al. 2018, equation 5, with twice its factor.

        Args:
            outputs: Q, (members, n, columns).
            targets: y, (n, k), ascending.
            weight: of each row, (n,).
        """
        errors = outputs - targets
        gradient = errors * weight.unsqueeze(1)
        return torch.dot(gradient.view(-1), errors.view(-1)), gradient.mul_(2)

    def mean(self, outputs: Tensor) -> Tensor:
        """The mean of the last axis of outputs or targets: the expected return."""
        return outputs.squeeze(-1)

    def policy_value(self, outputs: Tensor) -> Tensor:
        """The value that the policy maximises: (n,)."""
        return outputs.squeeze(-1).amin(0)

    def policy_value_gradient(self, outputs: Tensor, value: Tensor, gradient: Tensor) -> Tensor:
        """The gradient by the outputs, from `gradient` (n,) by `value`, the result of `policy_value`."""
        return (outputs == value.unsqueeze(1)) * gradient.unsqueeze(1)


JUDGED_ROWS = 32
"""The number of rows that critics judge for imitation is rounded up to a multiple of this."""


class ActorCritic(TorchAgent):
    """Networks, optimisers, exploration and state; an algorithm adds its losses in `learn`.

    Raises:
        UsageError: the environment takes discrete actions.
    """

    on_policy: ClassVar[bool] = False
    critics_see_more: ClassVar[bool] = True
    shaping: ClassVar[tuple[str, ...]] = ("hidden", "fine_goal", "layer_norm", "per_joint")
    arrays: ClassVar[int] = 16  # measured: 21 for SAC
    critics: ClassVar[int] = 2
    judges: ClassVar[int | None] = None
    """Number of critics that judge the policy's actions; None: all."""
    policy_columns: ClassVar[int] = 1
    """Outputs of the policy network per action column."""
    critic_kind: Critic = Critic()
    """The meaning of the critics' outputs."""

    def __init__(self, settings: Any, signature: Signature, seeds: SeedTree, device: str = "cpu") -> None:
        if isinstance(signature.action, Discrete):
            raise UsageError(
                f"{type(self).__name__.lower()} gives continuous actions, and this environment takes one of "
                f"{len(signature.action.labels)} discrete ones",
                setting="agent",
                hint="choose dqn, or continuous actions: a robot has them with environment.actions=continuous",
            )
        self.actions = actions = signature.action.size
        super().__init__(settings, signature, seeds, device)
        self.policy, self.critic = self._networks(signature)
        self.average = self.policy
        """The policy without exploration. An average over updates errs less than its policies (Polyak and Juditsky
        1992, "Acceleration of Stochastic Approximation by Averaging")."""
        if settings.policy_average < 1:
            self.average = self.policy.copy()
            self.stored = (*self.stored, "average")
        self.target = self.critic.copy()
        self.noise = Noise(settings.noise, self.inputs, actions, self.device)
        self.optimisers = {"policy": self.adam(self.policy.vector), "critic": self.adam(self.critic.vector)}
        self._bounds = value_bounds(signature, settings.discount, clip=settings.clip_targets)

    def _networks(self, signature: Signature) -> tuple[MLP, MLP]:
        """The policy and the critics, as the settings say."""
        settings, generator, device = self.settings, self.weights_generator, str(self.device)
        before = self.inputs + self.critic_only
        sizes = (self.inputs, *settings.hidden, self.policy_columns * self.actions)
        critic_sizes = (before + self.actions, *settings.hidden, self.critic_kind.columns)
        more: dict[str, Any] = {"members": self.critics, "layer_norm": settings.layer_norm}
        if not settings.per_joint:
            bfloat16 = uses_bfloat16(settings.precision, device)
            policy = MLP(NetworkShape(sizes, bfloat16=bfloat16), generator, device)
            return policy, MLP(NetworkShape(critic_sizes, bfloat16=bfloat16, **more), generator, device)
        seen, moved = joint_columns(signature.observation.acting), joint_columns(signature.action)
        if not seen or len(seen) != len(moved):
            what, hint = "observations and actions do not describe joints", "set robot.joint_slots, or per_joint: false"
            raise UsageError(what, setting="agent.per_joint", hint=hint)
        # of each joint the mean of its actions and, in SAC, the deviation
        parts = range(self.policy_columns)
        each = tuple(tuple(part * self.actions + column for part in parts for column in row) for row in moved)
        policy_shape = JointShape(sizes, joints=seen, each=each)
        both = tuple(row + tuple(before + column for column in own) for row, own in zip(seen, moved, strict=True))
        critic_shape = JointShape(critic_sizes, joints=both, each=((),) * len(seen), **more)
        return JointNetwork(policy_shape, generator, device), JointNetwork(critic_shape, generator, device)

    def check(self, buffer: Buffer, *, demonstrations: bool) -> None:
        """Raise a UsageError if imitation is set and nothing can be imitated, or the reverse."""
        if self.settings.imitation == 0:
            super().check(buffer, demonstrations=demonstrations)
        elif not (demonstrations or buffer.marks_relabelled):
            raise UsageError(
                "there are no demonstrations to imitate",
                setting="agent.imitation",
                hint="add demonstrations: {episodes: 100}, set buffer.hindsight.imitate=true to imitate relabelled "
                "transitions, or set agent.imitation=0",
            )

    def best(self, inputs: Tensor) -> Tensor:
        return torch.tanh(self.average(inputs, exact=True)[:, : self.actions])

    def explore(self, inputs: Tensor, environments: NDArray[int64] | None) -> Tensor:
        """The policy's actions with noise, each replaced with a probability by a uniform one in [-1, 1].

        In the quiet environments, a fixed share of all, the policy acts as it is. Source: mixed exploration (Li et al.
        2023, arXiv 2307.12983), of which this is the case with two sizes of noise.
        """
        output = self.policy(inputs, exact=True)
        action = self.noisy(output, self.noise.draw(inputs, self.generator, environments))
        if share := self.settings.random_actions:
            drawn = torch.rand((len(action), self.actions + 1), generator=self.generator, device=self.device)
            action = torch.where(drawn[:, :1] < share, drawn[:, 1:] * 2 - 1, action)
        if self.settings.quiet and environments is not None:
            # Multiples of the golden ratio spread evenly: the share holds for any number of environments.
            quiet = torch.from_numpy(environments * GOLDEN % 1 < self.settings.quiet).to(self.device)
            action = torch.where(quiet.unsqueeze(1), torch.tanh(output[:, : self.actions]), action)
        return action

    @abstractmethod
    def noisy(self, output: Tensor, noise: Tensor) -> Tensor:
        """Exploring actions (n, a) from the policy network's output and standard normal noise (n, a)."""

    def begin_episodes(self, environments: NDArray[int64]) -> None:
        self.noise.begin(environments)

    def targets(self, batch: TensorBatch, next_action: Tensor, entropy: Tensor | None = None) -> Tensor:
        """y = r + discount (Q'(s', a') + entropy), clipped to the possible values: (n, k).

        Args:
            batch: n transitions.
            next_action: a', (n, a).
            entropy: - temperature log pi(a' | s'), (n,). Source: Haarnoja et al. 2018, equations 3 and 5.
        """
        values = self.critic_kind.target_values(self.target(torch.cat((batch.next_critic_input, next_action), 1)))
        if entropy is not None:
            values = values + entropy.unsqueeze(1)
        y = torch.addcmul(batch.reward.unsqueeze(1), batch.discount.unsqueeze(1), values)
        return y.clamp_(*self._bounds)

    def critic_step(self, batch: TensorBatch, targets: Tensor) -> Metrics:
        """One gradient step of the critics towards the targets (n, k). Returns metrics.

        Under `priorities` they have the error |Q - y| of each transition, (n,), the largest of the critics.
        """
        outputs, tapes = self.critic.forward(torch.cat((batch.critic_input, batch.action), 1))
        loss, gradient = self.critic_kind.loss(outputs, targets, batch.weight)
        self.critic.backward(gradient, tapes)
        self.optimisers["critic"].step(self.critic.gradient)
        values, expected = self.critic_kind.mean(outputs), self.critic_kind.mean(targets)
        return {
            "priorities": (values - expected).abs_().amax(0),
            "critic_loss": loss,
            "value_mean": values.mean,
            "value_max": values.max,
            "target_mean": expected.mean,
            "critic_gradient_norm": self.optimisers["critic"].gradient_norm,
        }

    def preferred(self, batch: TensorBatch, action: Tensor) -> Tensor:
        """Whether the critics prefer the batch's action to `action` (n, a): (n,). Only demonstrated rows count."""
        assert batch.demonstrated is not None
        if self.settings.cloning:
            return torch.ones_like(batch.demonstrated)
        # oneDNN compiles a kernel for each number of rows, so few numbers may occur.
        count = -(-max(int(batch.demonstrated.count_nonzero()), 1) // JUDGED_ROWS) * JUDGED_ROWS
        rows = batch.demonstrated.argsort(descending=True, stable=True)[:count]
        pairs = torch.cat((batch.action[rows], action[rows]))
        inputs = torch.cat((batch.critic_input[rows].repeat(2, 1), pairs), 1)
        outputs, _ = self.critic.forward(inputs, members=self.judges)
        shown, own = self.critic_kind.policy_value(outputs).chunk(2)
        return torch.zeros_like(batch.demonstrated, dtype=torch.bool).index_copy_(0, rows, shown > own)

    def values_and_gradient(self, batch: TensorBatch, action: Tensor) -> tuple[Tensor, Tensor]:
        """Q(s, a), (n,), and the gradient of - sum_i weight_i Q(s_i, a_i) + action_penalty mean(a^2) by a, (n, a).

        With `cloning` the gradient is 0.
        """
        outputs, tapes = self.critic.forward(torch.cat((batch.critic_input, action), 1), members=self.judges)
        values = self.critic_kind.policy_value(outputs)
        by_outputs = self.critic_kind.policy_value_gradient(outputs, values, -batch.weight)
        columns = slice(self.inputs + self.critic_only, None)
        by_action = self.critic.backward(by_outputs, tapes, parameters=False, columns=columns)
        assert by_action is not None
        if self.settings.cloning:
            return values, by_action.zero_()
        if self.settings.action_penalty:
            by_action.add_(action, alpha=2 * self.settings.action_penalty / action.numel())
        return values, by_action

    def step_policy(self, by_output: Tensor, tapes: Sequence[Tape]) -> Metrics:
        """One gradient step of the policy from the gradient by its output. Returns metrics."""
        self.policy.backward(by_output, tapes)
        self.optimisers["policy"].step(self.policy.gradient)
        if self.average is not self.policy:
            self.average.follow(self.policy, self.settings.policy_average)
        return {"policy_gradient_norm": self.optimisers["policy"].gradient_norm}

    def start_from(self, state: State) -> None:
        """As `Agent.start_from`; the policy begins as the one that acts in the other agent's tests."""
        super().start_from({**state, "policy": state.get("average", state["policy"])})
        if self.average is not self.policy:
            self.average.vector.copy_(self.policy.vector)

    def adopt(self, policy: Deployed) -> None:
        for network in (self.policy, self.average):
            network.adopt(policy)
        self.normaliser.adopt(torch.from_numpy(policy.shift), torch.from_numpy(policy.scale))

    def deployed(self) -> Deployed:
        """The mean of the policy, squashed by tanh."""
        return self.policy_arrays(self.average, "tanh", slice(self.actions))


def imitation_loss(action: Tensor, preferred: Tensor, batch: TensorBatch) -> tuple[Tensor, Tensor]:
    """sum_i d_i p_i |pi(s_i) - a_i|^2 / sum_i d_i, and its gradient 2 d_i p_i (pi(s_i) - a_i) / sum d by pi(s_i).

    d_i: demonstrated, or relabelled with `hindsight.imitate`; p_i: `preferred`, the critics like a_i more.
    Source: Nair et al. 2018, "Overcoming Exploration in Reinforcement Learning with Demonstrations", equations 3 and 5.
    """
    assert batch.demonstrated is not None
    difference = action - batch.action
    weight = batch.demonstrated * preferred / batch.demonstrated.sum().clamp(min=1)
    return torch.dot(weight, difference.square().sum(1)), 2 * weight.unsqueeze(1) * difference


class Quantiles(BaseSettings):
    """Truncated quantile critics, TQC (Kuznetsov et al. 2020, arXiv 2005.04269).

    Defaults are those of the paper (25 atoms; 2 to drop on most of its tasks).
    """

    quantiles: int = Setting(25, ge=2, le=1000, description="quantiles of the return per critic")
    drop: int = Setting(
        2, ge=0, description="largest quantiles per critic that targets leave out, against overestimation"
    )

    @model_validator(mode="after")
    def _some_stay(self) -> Self:
        if self.drop >= self.quantiles:
            raise ValueError(f"drop {self.drop} leaves none of {self.quantiles} quantiles: give a smaller one")
        return self


class QuantileCritic(Critic):
    """Each network gives quantiles of the return. Targets leave out the `drop` x members largest."""

    def __init__(self, settings: Quantiles) -> None:
        self.columns = settings.quantiles
        self._drop = settings.drop

    def target_values(self, outputs: Tensor) -> Tensor:
        """The quantiles of all critics together, (n, k), ascending."""
        members, _, quantiles = outputs.shape
        pooled = outputs.movedim(0, 1).flatten(1)
        return pooled.sort(dim=1).values[:, : members * (quantiles - self._drop)]

    def loss(self, outputs: Tensor, targets: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
        """sum over members and rows of weight mean_jk |tau_j - 1{u < 0}| huber(u), and its gradient by the quantiles.

        u = y_k - theta_j, tau_j = (2 j + 1) / 2 q, huber(u) = u^2 / 2 where |u| <= 1, else |u| - 1/2. Source: Dabney
        et al. 2018, equation 10, kappa = 1. Both come from cumulative sums over the ascending targets; the members x n
        x q x k differences take twice as long, most of it for fresh memory.
        """
        members, rows, quantiles = outputs.shape
        tau = ((torch.arange(quantiles, device=outputs.device) + 0.5) / quantiles).repeat(members)
        weight = (weight / (quantiles * targets.shape[1])).unsqueeze(1)
        centre = targets.mean(1, keepdim=True)  # sums of squares about the mean lose the fewest digits
        flat = outputs.movedim(0, 1).flatten(1)
        below, above = _huber_sums((targets - centre).double(), (flat - centre).double())
        loss = (weight * ((1 - tau) * below[0] + tau * above[0])).sum()
        gradient = weight * ((1 - tau) * below[1] + tau * above[1])
        return loss.to(outputs.dtype), gradient.view(rows, members, quantiles).movedim(1, 0).to(outputs.dtype)

    def mean(self, outputs: Tensor) -> Tensor:
        return outputs.mean(-1)

    def policy_value(self, outputs: Tensor) -> Tensor:
        return outputs.mean((0, 2))

    def policy_value_gradient(self, outputs: Tensor, value: Tensor, gradient: Tensor) -> Tensor:  # noqa: ARG002
        return (gradient / (outputs.shape[0] * outputs.shape[2])).view(1, -1, 1).expand_as(outputs)


def _huber_sums(targets: Tensor, values: Tensor) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
    """Sums of huber(target - value), and their derivatives by the value, over the targets below and above each value.

    Args:
        targets: (n, k), ascending.
        values: (n, v).

    Returns:
        (sum, derivative) below, and (sum, derivative) above: (n, v) each.
    """
    powers = torch.stack((targets, targets.square())).cumsum(2)
    sums = torch.nn.functional.pad(powers, (1, 0))  # of the first 0 .. k targets, and of their squares
    places = [torch.searchsorted(targets, values + distance) for distance in (-1, 0, 1)]
    low, middle, high = ([sums[power].gather(1, place) for power in (0, 1)] for place in places)
    counts = [place.to(values.dtype) for place in places]  # targets below value - 1, value, value + 1
    far_above = targets.shape[1] - counts[2]

    def squared(first: list[Tensor], last: list[Tensor], number: Tensor) -> tuple[Tensor, Tensor]:
        """Half the squared distances of the targets between two places, and the sum of their distances."""
        one, two = last[0] - first[0], last[1] - first[1]
        return (two - 2 * values * one + number * values.square()) / 2, one - number * values

    squared_below, distance_below = squared(low, middle, counts[1] - counts[0])
    squared_above, distance_above = squared(middle, high, counts[2] - counts[1])
    linear_below = counts[0] * (values - 0.5) - low[0]
    linear_above = sums[0][:, -1:] - high[0] - far_above * (values + 0.5)
    below = (squared_below + linear_below, counts[0] - distance_below)
    return below, (squared_above + linear_above, -distance_above - far_above)
