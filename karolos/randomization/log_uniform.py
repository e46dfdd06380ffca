"""Values whose logarithm is uniform: for what may be ten times smaller or larger."""

from __future__ import annotations

from math import exp, log

from pydantic import Field as Setting
from pydantic import model_validator

from ..core import Settings as BaseSettings
from ..core.seeding import Generator
from .distribution import Distribution


class LogUniform(Distribution):
    """Values in [low, high] with uniformly distributed logarithm; both bounds are positive."""

    class Settings(BaseSettings):
        low: float = Setting(gt=0, description="in the parameter's unit")
        high: float = Setting(gt=0, description="in the parameter's unit")

        @model_validator(mode="after")
        def _ordered(self) -> LogUniform.Settings:
            if self.high < self.low:
                raise ValueError(f"high ({self.high:g}) must not be less than low ({self.low:g})")
            return self

    def __init__(self, settings: LogUniform.Settings) -> None:
        self.settings = settings

    def draw(self, generator: Generator) -> float:
        low, high = self.settings.low, self.settings.high
        # exp(log(x)) may leave the bounds by a rounding error
        return min(max(exp(generator.uniform(log(low), log(high))), low), high)
