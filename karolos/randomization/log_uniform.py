"""Log-uniform distribution: for values that may be ten times smaller or larger."""

from __future__ import annotations

from math import exp, log

from pydantic import Field as Setting

from ..core.seeding import Generator
from .distribution import Distribution
from .uniform import Uniform


class LogUniform(Distribution):
    """Values in [low, high] with uniformly distributed logarithm; both bounds are positive."""

    class Settings(Uniform.Settings):
        low: float = Setting(gt=0, description="in the parameter's unit")
        high: float = Setting(gt=0, description="in the parameter's unit")

    settings: Settings

    def draw(self, generator: Generator) -> float:
        low, high = self.settings.low, self.settings.high
        # exp(log(x)) may leave the bounds by a rounding error
        return min(max(exp(generator.uniform(log(low), log(high))), low), high)
