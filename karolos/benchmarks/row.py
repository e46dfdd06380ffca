"""What every benchmark gives back."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Row:
    """One measurement, and what it is measured against. `ratio` is value by peer_value."""

    benchmark: str
    case: str
    value: float
    unit: str
    peer: str | None = None
    peer_value: float | None = None

    @property
    def ratio(self) -> float | None:
        return self.value / self.peer_value if self.peer_value else None

    def dump(self) -> dict[str, Any]:
        """The columns that scripts rely on; JSON-able."""
        return {**asdict(self), "ratio": self.ratio}
