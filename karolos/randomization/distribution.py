"""What a distribution plugin is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from pydantic import BaseModel

from ..core.seeding import Generator


class Distribution(ABC):
    """Where the values of a randomized parameter come from; in the parameter's unit."""

    Settings: ClassVar[type[BaseModel]]

    @abstractmethod
    def __init__(self, settings: Any) -> None: ...

    @abstractmethod
    def draw(self, generator: Generator) -> float:
        """One value. All randomness comes from `generator`."""
