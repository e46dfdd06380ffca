"""What an episode is measured by, besides success and return."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Better = Literal["smaller", "larger"]


@dataclass(frozen=True)
class Measure:
    """A number of an episode, known at its end; nan where it is undefined, as the time to success of a failure."""

    name: str
    unit: str
    better: Better
    """Which of two values is better."""
    description: str
    """One line."""

    def text(self, value: float) -> str:
        """A value for a person: "peak_force 21.9 N"."""
        return f"{self.name} {value:.3g}{'' if self.unit == '1' else f' {self.unit}'}"
