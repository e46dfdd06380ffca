"""The interface of agents."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Generic

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from ..errors import UsageError
from .arrays import FloatArray, State
from .experience import Experience
from .signature import Signature

if TYPE_CHECKING:
    from .deployed import Deployed
    from .seeding import SeedTree


class Agent(ABC, Generic[Experience]):
    """A reinforcement-learning algorithm: acts, and learns from what it is given. Owns no buffer, file or environment.

    `Agent` alone learns from batches; an on-policy one is an `Agent[Rollout]`.
    """

    Settings: ClassVar[type[BaseModel]]
    on_policy: ClassVar[bool]
    """Whether it must learn from its own latest actions only (PPO) or can learn from old ones (replay)."""
    learned: ClassVar[tuple[str, ...]] = ()
    """Keys of its state that hold what it has learned, which an agent of the same kind can start from."""

    discount: float

    @abstractmethod
    def __init__(self, settings: Any, signature: Signature, seeds: SeedTree, device: str = "cpu") -> None: ...

    @abstractmethod
    def act(
        self,
        observation: FloatArray,
        desired_goal: FloatArray,
        *,
        explore: bool,
        environments: NDArray[np.int64] | None = None,
    ) -> FloatArray:
        """Actions (n, a) for observations (n, o) and goals (n, g). Without exploration it is deterministic.

        Continuous ones lie in [-1, 1], but for those of an exploring on-policy agent: they are stored as they are, and
        clipped for the environment.

        Args:
            observation: (n, o).
            desired_goal: (n, g).
            explore: act as in training.
            environments: whose rows these are, (n,), for exploration that remembers; None: 0 .. n - 1.
        """

    def begin_episodes(self, environments: NDArray[np.int64]) -> None:
        """New episodes begin in these environments. Nothing to do where exploration remembers nothing of the old."""

    @abstractmethod
    def learn(self, batch: Experience) -> Mapping[str, Any]:
        """One gradient update from a batch, or all those that a rollout is good for.

        Returns named scalars as tensors on the device, read by whoever needs a number. May hold "priorities": (n,) one
        non-negative number for each transition, the size of its error; and "updates": how many updates it took, if not
        one.
        """

    def deployed(self) -> Deployed:
        """How it acts without exploration, as plain arrays, for use outside karolos.

        Raises:
            UsageError: this kind of agent cannot be written down so.
        """
        raise UsageError(
            f"{type(self).__name__} cannot be exported", hint="its class would have to say how it acts: `deployed`"
        )

    @abstractmethod
    def state(self) -> State:
        """Everything that `load_state` needs to go on bit for bit: weights, optimisers, statistics, generators."""

    @abstractmethod
    def load_state(self, state: State) -> None: ...

    def start_from(self, state: State) -> None:
        """Take over what another agent of the same kind has learned; optimisers and generators stay as they are.

        Raises:
            UsageError: this kind of agent does not say what it learns, or the state is of networks of another shape.
        """
        if not self.learned:
            raise UsageError(
                f"{type(self).__name__} cannot start from another run's agent",
                where="agent.start_from",
                hint="its class would have to name what it learns: `learned`",
            )
        self.load_state({**self.state(), **{key: state[key] for key in self.learned}})
