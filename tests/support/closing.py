"""What is closed when its test ends."""

from typing import Protocol, TypeVar


class Closing(Protocol):
    """An environment or a world."""

    def close(self) -> None: ...


Opened = TypeVar("Opened", bound=Closing)
_OPEN: list[Closing] = []


def opened(made: Opened) -> Opened:
    """What the end of the test closes."""
    _OPEN.append(made)
    return made


def close_all() -> None:
    while _OPEN:
        _OPEN.pop().close()
