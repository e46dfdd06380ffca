"""The interface of environments."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from .arrays import Array, FloatArray
from .experience import Step
from .signature import Signature


class Environment(ABC):
    """One environment: a world that is reset with a seed and then takes actions until its episode ends.

    The same seed and the same actions give the same episode, bit for bit, in a fresh and in a used environment.
    """

    signature: Signature

    @abstractmethod
    def reset(self, seed: int) -> Step:
        """Begin the episode that `seed` (non-negative) determines."""

    @abstractmethod
    def step(self, action: Array) -> Step:
        """Take one action: (action.size,) float32, or an index for a discrete set. Raises RuntimeError after an end."""

    def parameters(self) -> FloatArray:
        """The values domain randomization drew for this episode, as `signature.parameters` lays them out."""
        return np.zeros(0, np.float32)

    def render(self, width: int = 640, height: int = 480) -> NDArray[np.uint8]:
        """A picture of the world as it is now: (height, width, 3)."""
        raise NotImplementedError(f"{type(self).__name__} has no pictures")

    def close(self) -> None:  # noqa: B027 (nothing to free by default)
        """Free what the environment holds. Safe to call twice."""
