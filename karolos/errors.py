"""Errors that a person can act on: each says what is wrong, where, and what to do.

The command line prints them without a traceback and ends with the error's exit code.
Whatever is not a KarolosError is a fault of karolos or of a plugin and keeps its traceback.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


class KarolosError(Exception):
    """A failure with a cause outside karolos.

    Args:
        what: what is wrong, in one line.
        where: file:line:column, key path, run or plugin concerned.
        hint: what is allowed, or what to do.
    """

    exit_code = 1

    def __init__(self, what: str, *, where: str | None = None, hint: str | None = None) -> None:
        super().__init__(what)
        self.what = what
        self.where = where
        self.hint = hint

    def __str__(self) -> str:
        line = f"{self.where}: {self.what}" if self.where else self.what
        return f"{line}; {self.hint}" if self.hint else line

    def __reduce__(self) -> tuple[object, ...]:
        """Keep keyword arguments when an error crosses a process boundary."""
        return _rebuild, (type(self), self.__dict__.copy())


def _rebuild(kind: type[KarolosError], attributes: dict[str, object]) -> KarolosError:
    error = kind.__new__(kind)
    Exception.__init__(error, attributes.get("what", ""))
    error.__dict__.update(attributes)
    return error


class UsageError(KarolosError):
    """A command, selector or argument that cannot be meant."""

    exit_code = 2


@dataclass(frozen=True)
class Problem:
    """One mistake in a spec; `where` is file:line:column, or the override that brought it in."""

    where: str
    path: str
    what: str
    hint: str | None = None

    def __str__(self) -> str:
        line = f"{self.where}: {self.path}: {self.what}" if self.path else f"{self.where}: {self.what}"
        return f"{line}; {self.hint}" if self.hint else line


class SpecError(KarolosError):
    """A spec that is not valid. Carries every problem found, one line each."""

    exit_code = 2

    def __init__(self, problems: Sequence[Problem]) -> None:
        super().__init__("\n".join(str(problem) for problem in problems))
        self.problems = tuple(problems)


class PluginError(KarolosError):
    """A plugin that is missing a file, does not import, clashes with another or breaks its interface."""

    exit_code = 3


class MachineError(KarolosError):
    """The machine cannot do what is asked: no display, a full disk, a folder that cannot be written."""

    exit_code = 3


class StoreError(KarolosError):
    """The results database cannot be opened, is newer than this karolos, or is no karolos database."""

    exit_code = 4


class RunError(KarolosError):
    """A run that failed: a worker that died, a loss that is not a number."""


class WorkerError(RunError):
    """An exception inside a worker process. `traceback` is the worker's own, as text."""

    def __init__(self, what: str, *, where: str | None = None, hint: str | None = None, traceback: str = "") -> None:
        super().__init__(what, where=where, hint=hint)
        self.traceback = traceback
