"""Errors that a person can act on: each says what is wrong, where, and what to do.

The command line prints them without a traceback and ends with the error's exit code.
Any other exception is a bug in karolos and keeps its traceback. One in a third party's plugin becomes a PluginError
at the plugin's line (`registry.blaming`); in the environments of a run it keeps its traceback, too.
What is said or recorded shows no secrets: `recorded` and `redact` decide what looks like one.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

LONGEST = 1000
"""Most characters that an error says of what is wrong: a value that it repeats may have any length."""


_PATH = re.compile(r"(?:(?<=:///)|(?<![\w.:/~*-]))/(?:[^/\s\"'=:,]+/)+")
_SECRET = (
    r"(?:pass(?:word|wd|phrase|code)|secret|token|credential|(?:api|access|private|auth|secret|signing)[_-]?key"
    r"|(?<![a-z0-9])(?:pass|pwd|pw|auth|authorization|bearer))s?(?:[_-]?(?:key|value|id))?"
)
_SECRETS = (
    (re.compile(r"(?<=://)(?:[^/\s@:]*:\S*|[^/\s@]+)@"), "***@"),
    (re.compile(r"-----BEGIN [A-Z ]*PRIVATE KEY-----.*?(?:-----END [A-Z ]*-----|\Z)", re.DOTALL), "***"),
    (re.compile(r"\b(?:gh[a-z]_|github_pat_|glpat-|hf_|sk-|xox[a-z]-|AKIA)[\w-]{12,}"), "***"),
    (
        re.compile(
            rf"""({_SECRET}["']?\s*[:=]\s*(?:(?:bearer|basic)\s+)?)(?!None\b|str\b|true\b|false\b|null\b)"""
            r"""("[^"\n]*"|'[^'\n]*'|(?![A-Za-z_][\w.]*[(\[])[^\s"'&;,)\]}]+)""",
            re.IGNORECASE,
        ),
        r"\1***",
    ),
)
"""User and password in a URL, keys, tokens of well-known services, and the values of what is called a secret."""


def is_secret(key: str) -> bool:
    """Whether a setting or an option of this name holds a secret."""
    return re.search(rf"{_SECRET}$", key, re.IGNORECASE) is not None


def redact(text: str) -> str:
    """Replace what looks like a secret by ***; in doubt, too much is replaced."""
    for pattern, shown in _SECRETS:
        text = pattern.sub(shown, text)
    return text


def recorded(value: Any, key: str = "", *, folders: bool = True) -> Any:
    """JSON as records hold it: with *** in place of what looks like a secret, and maybe without folders of paths."""
    if isinstance(value, Mapping):
        return {name: recorded(one, name, folders=folders) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [recorded(one, key, folders=folders) for one in value]
    if not isinstance(value, str):
        return value
    text = "***" if value and is_secret(key) else redact(value)
    return text if folders else without_folders(text)


def without_folders(text: str) -> str:
    """A text with .../name in place of each absolute path: folders tell machines and users."""
    return _PATH.sub(".../", text)


def _cut(text: str) -> str:
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."


class KarolosError(Exception):
    """A failure with a cause outside karolos.

    Args:
        what: what is wrong, in one line.
        where: the file:line:column, run or folder.
        setting: the key path of the setting that causes it, e.g. "buffer.capacity".
        plugin: kind and name of the plugin that causes it, e.g. ("robots", "panda").
        hint: what is allowed, or what to do.
    """

    exit_code = 1

    def __init__(
        self,
        what: str,
        *,
        where: str | None = None,
        setting: str | None = None,
        plugin: tuple[str, str] | None = None,
        hint: str | None = None,
    ) -> None:
        super().__init__(what)
        self.what = _cut(what)
        self.where = where
        self.setting = setting
        self.plugin = plugin
        self.hint = hint

    def __str__(self) -> str:
        return _line(self.where, self.setting, self.what, self.hint)


def _line(where: object, setting: str | None, what: str, hint: str | None) -> str:
    line = ": ".join(str(part) for part in (where and redact(str(where)), setting, what) if part)
    return f"{line}; {hint}" if hint else line


def described(error: BaseException) -> str:
    """Class and first line of an exception of anybody's."""
    try:
        lines = str(error).strip().splitlines()
    except Exception:  # its text is anybody's as well
        lines = []
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__


class UsageError(KarolosError):
    """An invalid command, selector or argument."""

    exit_code = 2


class NoSuchRunError(UsageError):
    """A selector that means no run."""


@dataclass(frozen=True)
class Problem:
    """One mistake in a spec."""

    where: Any
    """Its position: str() gives file:line:column, or the override."""
    setting: str
    what: str
    hint: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "what", _cut(self.what))

    def __str__(self) -> str:
        return _line(self.where, self.setting, self.what, self.hint)


class SpecError(KarolosError):
    """An invalid spec, with every problem found, one line each."""

    exit_code = 2

    def __init__(self, problems: Sequence[Problem]) -> None:
        super().__init__("")
        self.what = "\n".join(str(problem) for problem in problems)
        self.problems = tuple(problems)
        self.args = (self.problems,)  # pickle calls the class with them: an error may cross a process boundary


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

    def __init__(self, what: str, *, traceback: str = "", **place: Any) -> None:
        super().__init__(what, **place)
        self.traceback = traceback
