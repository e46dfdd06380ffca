"""Measures contestants side by side, and makes the rows of results.

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

from karolos.errors import MachineError

K = TypeVar("K", bound=Hashable)
T = TypeVar("T")


@dataclass(frozen=True)
class Row:
    """One measurement, and the peer's measurement."""

    case: str
    value: float
    unit: str
    peer: str | None = None
    peer_value: float | None = None
    ratios: tuple[float, ...] = field(default=(), repr=False)
    """value by peer_value in each turn; empty where the two were not measured in turns."""
    more: Mapping[str, Any] = field(default_factory=dict)
    """Further columns."""

    def dump(self) -> dict[str, Any]:
        """The columns that scripts rely on; JSON-able. `ratio` is the median over the turns."""
        columns = asdict(self)
        ratios, more = columns.pop("ratios"), columns.pop("more")
        single = self.value / self.peer_value if self.peer_value else None
        columns["ratio"] = median(ratios) if ratios else single
        columns |= {"ratio_min": min(ratios, default=None), "ratio_max": max(ratios, default=None)}
        return {**columns, **more}


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


def beside(case: str, values: Sequence[float], unit: str, peer: str, peer_values: Sequence[float]) -> Row:
    """The row of a contestant and a peer that were measured in the same turns."""
    ratios = tuple(value / other for value, other in zip(values, peer_values, strict=True))
    return Row(case, median(values), unit, peer, median(peer_values), ratios)


def seconds_of(work: Callable[[], object], clock: Callable[[], float] = perf_counter) -> float:
    """Seconds that a call takes by this clock; `process_time` does not count the time of other programs."""
    started = clock()
    work()
    return clock() - started


def require(*modules: str, hint: str) -> list[str]:
    """The installed ones of these modules of peers. Raises a MachineError with this hint if there is none."""
    found = [name for name in modules if find_spec(name) is not None]
    if not found:
        raise MachineError(f"{' and '.join(modules)} not installed, so there is no peer to measure", hint=hint)
    return found
