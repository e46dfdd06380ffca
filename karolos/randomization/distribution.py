"""The interface of a distribution plugin."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from pydantic import BaseModel

from ..core.seeding import Generator


class Distribution(ABC):
    """Distribution of a randomized parameter, in the parameter's unit."""

    Settings: ClassVar[type[BaseModel]]

    listed: tuple[float, ...] = ()
    """Values that the settings name one by one: each must lie in the parameter's range."""

    def __init__(self, settings: Any) -> None:
        self.settings = settings

    @abstractmethod
    def draw(self, generator: Generator) -> float:
        """One value. All randomness comes from `generator`."""
