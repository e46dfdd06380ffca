"""Uniform distribution."""

from __future__ import annotations

from typing import Self

from pydantic import Field as Setting
from pydantic import model_validator

from ..core import Settings as BaseSettings
from ..core.seeding import Generator
from .distribution import Distribution


class Uniform(Distribution):
    """Values in [low, high), all equally likely."""

    class Settings(BaseSettings):
        low: float = Setting(description="in the parameter's unit")
        high: float = Setting(description="in the parameter's unit")

        @model_validator(mode="after")
        def _ordered(self) -> Self:
            if self.high < self.low:
                raise ValueError(f"high ({self.high:g}) must not be less than low ({self.low:g})")
            return self

    settings: Settings

    def draw(self, generator: Generator) -> float:
        return float(generator.uniform(self.settings.low, self.settings.high))
