"""Listeners of runs: one keeps what it hears, one asks the run to stop."""

import signal
from collections.abc import Callable, Iterator
from typing import Any

from karolos.experiment.events import RunTested, RunWarned


class Heard:
    """Keeps every event that it is called with."""

    def __init__(self) -> None:
        self.events: list[Any] = []

    def __call__(self, event: object) -> None:
        self.events.append(event)

    def __iter__(self) -> Iterator[Any]:
        return iter(self.events)

    @property
    def warnings(self) -> list[str]:
        return [event.warning for event in self if isinstance(event, RunWarned)]


def stopping_at(steps: int, *signals: int) -> Callable[[object], None]:
    """A listener that raises these signals (SIGTERM) after each test at `steps` or later."""

    def tell(event: object) -> None:
        if isinstance(event, RunTested) and event.result.steps >= steps:
            for number in signals or (signal.SIGTERM,):
                signal.raise_signal(number)

    return tell
