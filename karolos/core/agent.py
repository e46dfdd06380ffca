"""The interface of agents, and a trained policy as plain arrays, for export."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from ..errors import UsageError
from .experience import Experience, State
from .seeding import SeedTree
from .signature import FloatArray, Signature

if TYPE_CHECKING:
    from .buffer import Buffer


Output = Literal["tanh", "clip", "argmax"]
"""How the last layer's output becomes an action: tanh, clipped to [-1, 1], or the index of the largest column."""


@dataclass(frozen=True)
class Layer:
    """x -> x @ weight.T + bias."""

    weight: FloatArray
    """(columns out, columns in)"""
    bias: FloatArray
    """(columns out,)"""


@dataclass(frozen=True)
class JointLayers:
    """Layers around a perceptron that treat the s joints of an arm alike.

    The row of joint j joins the columns own[j] and `shared` of x. `first` makes five parts of h columns of it: p, q, r,
    t and v. The perceptron's input joins sum_j max(p_j, 0) / sqrt(s), sum_j q_j r_j / sqrt(s) and the shared columns.
    Its output is y, z, each of h columns, and the rest. `last` makes the outputs of joint j of max(t_j + y, 0) and
    v_j z. Action column i is column order[i] of the outputs of all joints, followed by the rest.
    """

    own: NDArray[np.int64]
    """(s, k)"""
    shared: NDArray[np.int64]
    """(g,)"""
    order: NDArray[np.int64]
    """(a,)"""
    first: Layer
    """k + g columns in, 5 h out"""
    last: Layer
    """2 h columns in"""

    @property
    def units(self) -> int:
        """h"""
        return int(self.last.weight.shape[1]) // 2


@dataclass(frozen=True)
class Deployed:
    """A policy without exploration as float32 arrays.

    The input x joins the observation o, the desired goal g and the missing part g[missing[0]] - o[missing[1]].
    Then x = (x - shift) * scale. The missing part is bounded by tanh(x), the rest by clip(x, -clip, clip). The
    layers with max(x, 0) between them follow, and `output`. With `layer_norm`, each hidden layer is normalised
    before max(x, 0): (x - mean) / sqrt(variance + layer_norm), with mean and variance over the row. With `joints`,
    the layers are the perceptron between those of the joints.
    """

    shift: FloatArray
    """(i,)"""
    scale: FloatArray
    """(i,)"""
    clip: float
    layers: tuple[Layer, ...]
    output: Output
    layer_norm: float | None = None
    """None: no layer normalisation."""
    missing: NDArray[np.int64] = field(default_factory=lambda: np.zeros((2, 0), np.int64))
    """(2, k): columns of the goal, and columns of the observation with the achieved values of these."""
    joints: JointLayers | None = None
    """None: all columns are treated as they come."""

    @property
    def every_layer(self) -> tuple[Layer, ...]:
        """All layers, from the inputs to the outputs."""
        return self.layers if self.joints is None else (self.joints.first, *self.layers, self.joints.last)

    @classmethod
    def read(cls, path: Path) -> Deployed:
        """The policy in a policy.npz that `karolos export` wrote."""
        with np.load(path, allow_pickle=False) as file:
            layers = [Layer(file[f"weight{place}"], file[f"bias{place}"]) for place in range(int(file["layers"]))]
            norm, output = float(file["layer_norm"]), str(file["output"])
            norms = None if np.isnan(norm) else norm
            known = file["shift"], file["scale"], float(file["clip"])
            joints = None
            if "own" in file:
                first, last = (Layer(file[f"{name}_weight"], file[f"{name}_bias"]) for name in ("first", "last"))
                joints = JointLayers(file["own"], file["shared"], file["order"], first, last)
            return cls(*known, tuple(layers), output, norms, file["missing"], joints)  # type: ignore[arg-type]

    def __post_init__(self) -> None:
        columns = [self.shift.size, *(layer.bias.size for layer in self.layers)]
        if self.joints is not None:
            columns[0] = self.joints.last.weight.shape[1] + self.joints.shared.size
        shapes = [layer.weight.shape for layer in self.layers]
        if self.scale.shape != self.shift.shape or shapes != list(zip(columns[1:], columns[:-1], strict=True)):
            raise ValueError(f"{columns[0]} inputs do not fit layers of shapes {shapes}")


class Agent(ABC, Generic[Experience]):
    """A reinforcement-learning algorithm: acts, and learns from experience. Owns no buffer, file or environment.

    An `Agent` learns from batches of replayed transitions. An on-policy agent is an `Agent[Rollout]`.

    Call order. The loop calls `act(explore=True)` for the environments that are ready, and `begin_episodes` before the
    first action of new episodes. It calls `learn` as often as the replay ratio says, or once per complete rollout.
    Warm-up actions are sampled without the agent. Tests call `act(explore=False)` with any number of rows.

    Determinism. Random numbers come from generators made from `seeds`. The same calls give the same results bit for
    bit, also after `load_state(state())` in a new agent. `act(explore=False)` changes no state.

    Errors. `__init__` raises UsageError for a signature that the algorithm cannot handle, e.g. discrete actions.
    """

    Settings: ClassVar[type[BaseModel]]
    """Settings of the spec's `agent` part, derived from `AgentSettings`."""
    on_policy: ClassVar[bool]
    """Whether it learns from its own latest actions only (PPO), or also from old ones (replay)."""
    learned: ClassVar[tuple[str, ...]] = ()
    """Keys of its state with the learned weights, for `start_from`."""
    shaping: ClassVar[tuple[str, ...]] = ()
    """Settings that determine the shape or the meaning of the learned weights: `start_from` needs the same values."""

    discount: float
    """Discount factor per environment step. The loop gives it to the buffer."""

    @abstractmethod
    def __init__(self, settings: Any, signature: Signature, seeds: SeedTree, device: str = "cpu") -> None: ...

    def check(self, buffer: Buffer[Any], *, demonstrations: bool) -> None:  # noqa: ARG002 (interface)
        """Check before a run that the agent can learn from this buffer.

        Args:
            buffer: of the run, empty.
            demonstrations: whether it will hold demonstrations.

        Raises:
            UsageError: the buffer marks relabelled transitions, which by default an agent does not imitate.
        """
        if buffer.marks_relabelled:
            raise UsageError(
                f"{type(self).__name__} has no imitation term, so it cannot imitate relabelled transitions",
                setting="buffer.hindsight.imitate",
                hint="set agent.imitation=1 (sac, td3, ddpg), or remove imitate",
            )

    @abstractmethod
    def act(
        self,
        observation: FloatArray,
        desired_goal: FloatArray,
        *,
        explore: bool,
        environments: NDArray[np.int64] | None = None,
    ) -> FloatArray:
        """Actions (n, a), deterministic without exploration.

        Continuous actions are in [-1, 1]. Those of an exploring on-policy agent may be outside: the buffer stores them
        unchanged and the loop clips them for the environment. A discrete action is an index in one column.

        Args:
            observation: (n, o).
            desired_goal: (n, g).
            explore: act as in training.
            environments: the environment of each row, (n,), for exploration with a state; None: 0 .. n - 1.
        """

    def begin_episodes(self, environments: NDArray[np.int64]) -> None:
        """Reset the exploration state of these environments, whose next actions begin new episodes."""

    @abstractmethod
    def learn(self, batch: Experience) -> Mapping[str, Any]:
        """One gradient update from a batch, or all updates from a rollout.

        The arrays of the batch are valid during the call only.

        Returns:
            Named scalars, as tensors on the device. Optional entries: "priorities", (n,) the non-negative error of each
            transition, for `Buffer.update_priorities`; "updates", the number of updates, if not one.
        """

    def deployed(self) -> Deployed:
        """The policy without exploration, as plain arrays, for use outside karolos.

        Raises:
            UsageError: this kind of agent cannot be exported.
        """
        raise UsageError(f"{type(self).__name__} cannot be exported", hint="implement `deployed` in its class")

    def adopt(self, policy: Deployed) -> None:  # noqa: ARG002
        """Act without exploration as an exported policy does. Other parts, such as critics, do not change.

        Raises:
            UsageError: this kind of agent cannot take an exported policy.
        """
        raise UsageError(f"{type(self).__name__} cannot take a policy", hint="implement `adopt` in its class")

    @abstractmethod
    def state(self) -> State:
        """Everything that `load_state` needs to continue bit for bit: weights, optimisers, statistics, generators.

        Nested dicts of arrays, tensors, numbers and strings. Later updates must not change it.
        """

    @abstractmethod
    def load_state(self, state: State) -> None:
        """Continue from the state of an agent with the same settings. Raises UsageError for another shape."""

    def start_from(self, state: State) -> None:
        """Load the learned weights from the state of another agent; optimisers and generators do not change.

        Raises:
            UsageError: the class has no `learned` keys, or the state has networks of another shape.
        """
        if not self.learned:
            raise UsageError(
                f"{type(self).__name__} cannot start from another run's agent",
                setting="agent.start_from",
                hint="set `learned` in its class",
            )
        self.load_state({**self.state(), **{key: state[key] for key in self.learned}})
