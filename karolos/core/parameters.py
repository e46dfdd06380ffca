"""The parameters that robots and tasks let domain randomization change, and how their settings declare them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import BaseModel
from pydantic import Field as Setting


@dataclass(frozen=True)
class RandomizedParameter:
    """A number of the world that a robot or a task lets domain randomization change between episodes."""

    unit: str
    nominal: float
    """Value without randomization."""
    low: float
    high: float
    """Values outside [low, high] are never applied."""
    description: str = ""

    @property
    def allowed(self) -> str:
        """The allowed range, for a message."""
        return f"allowed is {self.low:g} to {self.quantity(self.high)}"

    def quantity(self, value: float) -> str:
        """The value with its unit, for a message. A pure number has no unit."""
        return f"{value:g}" if self.unit == "1" else f"{value:g} {self.unit}"


@dataclass(frozen=True)
class Drawn:
    """Marks a setting that is also a parameter of randomization: `Annotated[float, Drawn("m", 0.0, 0.5)]`.

    Training episodes may sample it, tests never do. The range is widened to the setting's own value.
    """

    unit: str = "1"
    low: float = 0.0
    high: float = 1.0


Probability = Annotated[float, Drawn(), Setting(ge=0, le=1)]
"""A setting in [0, 1] that randomization may sample."""


def drawn_settings(settings: BaseModel) -> dict[str, RandomizedParameter]:
    """The parameters that fields of the settings declare with `Drawn`. Their nominal values are the settings."""
    found = {}
    for name, field in type(settings).model_fields.items():
        value = getattr(settings, name)
        for mark in (one for one in field.metadata if isinstance(one, Drawn)):
            low, high = min(mark.low, value), max(mark.high, value)
            found[name] = RandomizedParameter(mark.unit, value, low, high, field.description or "")
    return found
