"""Errors that a person can act on: each says what is wrong, where, and what to do.

The command line prints them without a traceback and ends with the error's exit code.
Any other exception is a bug in karolos or in a plugin and keeps its traceback.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


class KarolosError(Exception):
    """A failure with a cause outside karolos.

    Args:
        what: what is wrong, in one line.
        where: the file:line:column, key path, run or plugin.
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
        """Pickle all attributes: an error may cross a process boundary."""
        return _rebuild, (type(self), self.__dict__.copy())


def _rebuild(kind: type[KarolosError], attributes: dict[str, object]) -> KarolosError:
    error = kind.__new__(kind)
    Exception.__init__(error, attributes.get("what", ""))
    error.__dict__.update(attributes)
    return error


class UsageError(KarolosError):
    """An invalid command, selector or argument."""

    exit_code = 2


class NoSuchRunError(UsageError):
    """A selector that means no run."""


@dataclass(frozen=True)
class Problem:
    """One mistake in a spec; `where` is its file:line:column, or its override."""

    where: str
    path: str
    what: str
    hint: str | None = None

    def __str__(self) -> str:
        line = f"{self.where}: {self.path}: {self.what}" if self.path else f"{self.where}: {self.what}"
        return f"{line}; {self.hint}" if self.hint else line


class SpecError(KarolosError):
    """An invalid spec, with every problem found, one line each."""

    exit_code = 2

    def __init__(self, problems: Sequence[Problem]) -> None:
        super().__init__("\n".join(str(problem) for problem in problems))
        self.problems = tuple(problems)


class PluginError(KarolosError):
    """A plugin that lacks a file, does not import, has the name of another or breaks its interface."""

    exit_code = 3


class MachineError(KarolosError):
    """A limit of the machine: the display is missing, the disk is full, a folder cannot be written."""

    exit_code = 3


class StoreError(KarolosError):
    """The results database cannot be opened, has another schema, or belongs to another program."""

    exit_code = 4


class RunError(KarolosError):
    """A run that failed: a worker that died, a loss that is not a number."""


class WorkerError(RunError):
    """An exception inside a worker process. `traceback` is the worker's own, as text."""

    def __init__(self, what: str, *, where: str | None = None, hint: str | None = None, traceback: str = "") -> None:
        super().__init__(what, where=where, hint=hint)
        self.traceback = traceback
