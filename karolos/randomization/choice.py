"""Choice among listed values."""

from __future__ import annotations

from pydantic import Field as Setting
from pydantic import model_validator

from ..core import Settings as BaseSettings
from ..core.seeding import Generator
from .distribution import Distribution


class Choice(Distribution):
    """One of `values`, equally likely or in proportion to `weights`."""

    class Settings(BaseSettings):
        values: tuple[float, ...] = Setting(min_length=1, description="in the parameter's unit")
        weights: tuple[float, ...] | None = Setting(None, description="relative, not negative; one for each value")

        @model_validator(mode="after")
        def _matching(self) -> Choice.Settings:
            if self.weights is None:
                return self
            if len(self.weights) != len(self.values):
                raise ValueError(f"{len(self.weights)} weights for {len(self.values)} values")
            if min(self.weights) < 0 or sum(self.weights) <= 0:
                raise ValueError("weights must not be negative, nor all 0")
            return self

    settings: Settings

    def __init__(self, settings: Choice.Settings) -> None:
        super().__init__(settings)
        self.listed = settings.values
        total = sum(settings.weights or ())
        self._probabilities = [weight / total for weight in settings.weights] if settings.weights else None

    def draw(self, generator: Generator) -> float:
        return self.settings.values[int(generator.choice(len(self.settings.values), p=self._probabilities))]
