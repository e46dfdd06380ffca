"""The interface of buffers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Generic

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from ..errors import UsageError
from .arrays import FloatArray, State
from .experience import Experience, Transitions
from .signature import Signature

if TYPE_CHECKING:
    from .seeding import SeedTree


class Buffer(ABC, Generic[Experience]):
    """Stores transitions and gives batches; an on-policy one is a `Buffer[Rollout]` and gives each rollout once."""

    Settings: ClassVar[type[BaseModel]]
    on_policy: ClassVar[bool]

    @abstractmethod
    def __init__(
        self, settings: Any, signature: Signature, seeds: SeedTree, *, environments: int, discount: float
    ) -> None: ...

    @abstractmethod
    def add(self, transitions: Transitions) -> None:
        """Store one transition of each environment named."""

    @abstractmethod
    def cut(self, environments: NDArray[np.int64]) -> None:
        """End the running episodes of these environments as they stand; the next transition begins a new one."""

    @abstractmethod
    def sample(self, size: int) -> Experience:
        """`size` transitions; a rollout is given as a whole, with `size = len(buffer)`.

        The arrays are valid until the next call; those of a rollout until the next `add`.
        """

    def add_demonstrations(self, episodes: Sequence[Transitions], share: float | None = None) -> None:  # noqa: ARG002 (interface)
        """Store demonstrations for good, beside the environments' transitions.

        Args:
            episodes: whole ones, each with its steps along the leading axis; `environment` is not looked at.
            share: of each batch that comes from demonstrations; None: they are sampled as all else is.

        Raises:
            UsageError: this buffer has no place for them.
        """
        raise UsageError(
            f"{type(self).__name__} keeps no demonstrations",
            where="demonstrations",
            hint="use a replay buffer, e.g. uniform, and an agent that learns from it",
        )

    def metrics(self) -> Mapping[str, float]:
        """Numbers about what is stored, for whoever watches a run; nothing by default."""
        return {}

    def update_priorities(self, slot: NDArray[np.int64], priorities: FloatArray) -> None:
        """Tell the sampler how large the errors of a batch were. Nothing to do where sampling is uniform."""

    @abstractmethod
    def __len__(self) -> int:
        """Transitions that can be sampled now: none of a rollout before it is complete."""

    @abstractmethod
    def state(self) -> State: ...

    @abstractmethod
    def load_state(self, state: State) -> None: ...
