"""Distributions of a randomized parameter."""

from __future__ import annotations

from abc import ABC, abstractmethod
from math import exp, log
from typing import Any, ClassVar, Self

from pydantic import BaseModel, model_validator
from pydantic import Field as Setting

from ..core import Generator
from ..core import Settings as BaseSettings


class Distribution(ABC):
    """Distribution of a randomized parameter, in the parameter's unit."""

    Settings: ClassVar[type[BaseModel]]

    listed: tuple[float, ...] = ()
    """Values that the settings list: each must lie in the parameter's range."""

    def __init__(self, settings: Any) -> None:
        self.settings = settings

    @abstractmethod
    def draw(self, generator: Generator) -> float:
        """One value. All randomness comes from `generator`."""


class UniformDistribution(Distribution):
    """Values in [low, high), all equally likely."""

    class Settings(BaseSettings):
        low: float = Setting(description="in the parameter's unit")
        high: float = Setting(description="in the parameter's unit")

        @model_validator(mode="after")
        def _ordered(self) -> Self:
            if self.high < self.low:
                raise ValueError(f"high ({self.high:g}) must not be less than low ({self.low:g})")
            return self

    def draw(self, generator: Generator) -> float:
        return float(generator.uniform(self.settings.low, self.settings.high))


class LogUniform(Distribution):
    """Values in [low, high] with uniformly distributed logarithm; both bounds are positive."""

    class Settings(UniformDistribution.Settings):
        low: float = Setting(gt=0, description="in the parameter's unit")
        high: float = Setting(gt=0, description="in the parameter's unit")

    def draw(self, generator: Generator) -> float:
        low, high = self.settings.low, self.settings.high
        # exp(log(x)) may leave the bounds by a rounding error
        return float(min(max(exp(generator.uniform(log(low), log(high))), low), high))


class Normal(Distribution):
    """Values around `mean` with standard deviation `std`, both in the parameter's unit."""

    class Settings(BaseSettings):
        mean: float = Setting(description="in the parameter's unit")
        std: float = Setting(ge=0, description="standard deviation in the parameter's unit")

    def draw(self, generator: Generator) -> float:
        return float(generator.normal(self.settings.mean, self.settings.std))


class Choice(Distribution):
    """One of `values`, equally likely or in proportion to `weights`."""

    class Settings(BaseSettings):
        values: tuple[float, ...] = Setting(min_length=1, description="in the parameter's unit")
        weights: tuple[float, ...] | None = Setting(None, description="relative, not negative; one for each value")

        @model_validator(mode="after")
        def _matching(self) -> Self:
            if self.weights is None:
                return self
            if len(self.weights) != len(self.values):
                raise ValueError(f"{len(self.weights)} weights for {len(self.values)} values")
            if min(self.weights) < 0 or sum(self.weights) <= 0:
                raise ValueError("weights must not be negative, nor all 0")
            return self

    def __init__(self, settings: Choice.Settings) -> None:
        super().__init__(settings)
        self.listed = settings.values
        total = sum(settings.weights or ())
        self._probabilities = [weight / total for weight in settings.weights] if settings.weights else None

    def draw(self, generator: Generator) -> float:
        return self.listed[int(generator.choice(len(self.listed), p=self._probabilities))]
