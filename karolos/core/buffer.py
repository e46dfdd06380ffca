"""The interface of buffers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Generic

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from ..errors import UsageError
from .experience import Experience, State, Transitions
from .signature import FloatArray, Signature

if TYPE_CHECKING:
    from .seeding import SeedTree


class Buffer(ABC, Generic[Experience]):
    """Stores transitions and returns batches. An on-policy buffer is a `Buffer[Rollout]` and returns each rollout once.

    Episodes. Successive transitions of an environment belong to one episode until one is `terminated` or `truncated`,
    or until `cut`. One call of `add` has at most one transition of each environment, in any order, of any subset. The
    arrays belong to the caller, so the buffer copies them.

    Rewards. With hindsight, reward and `terminated` of relabelled transitions come from `signature.goal_rule`.

    Determinism. Random numbers come from generators made from `seeds`. The same calls give the same batches bit for
    bit, also after `load_state(state())` in a new buffer.

    Errors. `__init__` raises UsageError for settings that do not fit the signature or the number of environments. `add`
    raises PluginError for transitions that contradict the goal rule. `sample` raises RunError if the buffer is empty.
    """

    Settings: ClassVar[type[BaseModel]]
    """Settings of the spec's `buffer` part."""
    on_policy: ClassVar[bool]
    """Whether it returns rollouts (`Buffer[Rollout]`) or batches. Must be that of the agent."""
    capacity: int | None = None
    """Transitions that it can hold, or those of a whole rollout. None: unknown."""
    marks_relabelled: bool = False
    """Whether `Batch.demonstrated` marks relabelled transitions, too."""

    @abstractmethod
    def __init__(
        self, settings: Any, signature: Signature, seeds: SeedTree, *, environments: int, discount: float
    ) -> None:
        """Make an empty buffer.

        Args:
            settings: an instance of `Settings`.
            signature: of the environments.
            seeds: of the buffer's generators.
            environments: number of environments; `Transitions.environment` is in 0 .. environments - 1.
            discount: per environment step.
        """

    @abstractmethod
    def add(self, transitions: Transitions) -> None:
        """Store at most one transition of each environment."""

    @abstractmethod
    def cut(self, environments: NDArray[np.int64]) -> None:
        """End the running episodes of these environments; the next transition begins a new episode.

        Called when a simulation diverged or a worker was lost. An environment without a running episode is ignored.
        """

    @abstractmethod
    def sample(self, size: int) -> Experience:
        """`size` transitions; for a rollout `size` is `len(buffer)`.

        The arrays are valid until the next call of `sample`, those of a rollout until the next `add`.
        """

    def add_demonstrations(self, episodes: Sequence[Transitions], share: float | None = None) -> None:  # noqa: ARG002 (interface)
        """Store demonstrations permanently, in addition to the environments' transitions.

        Args:
            episodes: whole episodes, each with its steps along the leading axis; `environment` is ignored.
            share: the fraction of each batch that comes from demonstrations; None: sample them like other transitions.

        Raises:
            UsageError: this buffer does not support demonstrations.
        """
        raise UsageError(
            f"{type(self).__name__} does not support demonstrations",
            setting="demonstrations",
            hint="use a replay buffer, e.g. uniform, and an off-policy agent",
        )

    def metrics(self) -> Mapping[str, float]:
        """Numbers about the content, for TensorBoard; empty by default."""
        return {}

    def update_priorities(self, slot: NDArray[np.int64], priorities: FloatArray) -> None:
        """Set the priorities of the transitions of a batch. Does nothing for uniform sampling.

        Args:
            slot: `Batch.slot`. Transitions that have been overwritten are ignored.
            priorities: absolute error of each transition under the goal that it had in the batch, (n,).
        """

    @abstractmethod
    def __len__(self) -> int:
        """Number of transitions that can be sampled; 0 before a rollout is complete."""

    @abstractmethod
    def state(self) -> State:
        """Everything that `load_state` needs to continue bit for bit; arrays are copies."""

    @abstractmethod
    def load_state(self, state: State) -> None:
        """Continue from a state. Raises UsageError for the state of a buffer of another shape."""
