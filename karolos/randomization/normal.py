"""Normal distribution."""

from __future__ import annotations

from pydantic import Field as Setting

from ..core import Settings as BaseSettings
from ..core.seeding import Generator
from .distribution import Distribution


class Normal(Distribution):
    """Values around `mean` with standard deviation `std`, both in the parameter's unit."""

    class Settings(BaseSettings):
        mean: float = Setting(description="in the parameter's unit")
        std: float = Setting(ge=0, description="standard deviation, in the parameter's unit")

    settings: Settings

    def draw(self, generator: Generator) -> float:
        return float(generator.normal(self.settings.mean, self.settings.std))
