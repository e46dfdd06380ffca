"""How contestants are measured side by side, and the row that comes of it.

Contestants take turns, so that load from other programs hits all of them alike. Figures are medians
over the turns, and the ratio is the median of the turns' ratios.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib.util import find_spec
from statistics import median
from time import perf_counter
from typing import Any, TypeVar

from ..errors import MachineError

K = TypeVar("K", bound=Hashable)
T = TypeVar("T")


@dataclass(frozen=True)
class Row:
    """One measurement, and the peer's measurement beside it.

    Args:
        benchmark: command below `karolos bench`.
        case: what is measured.
        value: the figure, in `unit`.
        peer: what stands beside it.
        peer_value: the peer's figure, in the same unit.
        ratios: value by peer_value in each turn; empty where the two were not measured in turns.
    """

    benchmark: str
    case: str
    value: float
    unit: str
    peer: str | None = None
    peer_value: float | None = None
    ratios: tuple[float, ...] = field(default=(), repr=False)

    @property
    def ratio(self) -> float | None:
        """Median over the turns, or value by peer_value where there are no turns."""
        if self.ratios:
            return median(self.ratios)
        return self.value / self.peer_value if self.peer_value else None

    def dump(self) -> dict[str, Any]:
        """The columns that scripts rely on; JSON-able."""
        columns = asdict(self)
        del columns["ratios"]
        lowest, highest = (min(self.ratios), max(self.ratios)) if self.ratios else (None, None)
        return {**columns, "ratio": self.ratio, "ratio_min": lowest, "ratio_max": highest}


def take_turns(
    contestants: Mapping[K, Callable[[int], T]], *, turns: int = 3, seconds: float = 0.0
) -> dict[K, list[T]]:
    """Measure each contestant once per turn, in the opposite order every second turn.

    Args:
        contestants: functions of the turn's number that return one measurement.
        turns: at least this many.
        seconds: another turn begins as long as this time is not over.

    Returns:
        The measurements of each contestant, turn by turn.
    """
    measured: dict[K, list[T]] = {name: [] for name in contestants}
    end, turn = perf_counter() + seconds, 0
    while turn < turns or perf_counter() < end:
        for name in reversed(measured) if turn % 2 else measured:
            measured[name].append(contestants[name](turn))
        turn += 1
    return measured


def beside(
    benchmark: str, case: str, values: Sequence[float], unit: str, peer: str, peer_values: Sequence[float]
) -> Row:
    """The row of a contestant and a peer that were measured in the same turns."""
    ratios = tuple(value / other for value, other in zip(values, peer_values, strict=True))
    return Row(benchmark, case, median(values), unit, peer, median(peer_values), ratios)


def require_modules(hint: str, *modules: str) -> None:
    """Raise a MachineError with this hint unless the peer's modules are installed."""
    missing = [name for name in modules if find_spec(name) is None]
    if missing:
        raise MachineError(f"{', '.join(missing)} not installed, so there is no peer to measure", hint=hint)
