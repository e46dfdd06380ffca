"""Errors that a person can act on: each says what is wrong, where, and what to do.

The command line prints them without a traceback and ends with the error's exit code.
Any other exception is a bug in karolos and keeps its traceback. One in a third party's plugin becomes a PluginError
at the plugin's line (`registry.blaming`); in the environments of a run it keeps its traceback, too.
Messages and records show no secrets: `recorded` and `redact` decide which texts look like one.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

LONGEST = 1000
"""Largest length of an error's text in characters. The values in it may have any length."""


_PATH = re.compile(
    r"(?:(?<=://)|(?<=:///)|(?<![\w./~*-]))/(?!/)(?:(?:home|Users)/[^/\s\"'=:,]+(?![^/\s\"'=:,])/?|(?:[^/\s\"'=:,]+/)+)"
    r"|\b[A-Za-z]:\\+(?:[^\\\s\"'=:,]+\\+)+"
)
_SECRET = (
    r"(?:pass(?:word|wd|phrase|code)|secret|token|credential|(?:api|access|private|auth|secret|signing)[_-]?key"
    r"|(?<![a-z0-9])(?<!(?:low|one|two|all)_)(?<!(?:high|band|next|last)_)(?<!by_)(?<!first_)(?<!forward_)"
    r"(?:pass|pwd|pw|auth|authorization|bearer)|(?<=[?&])(?:X-Amz-)?(?:sig|signature))s?(?:[_-]?(?:key|value|id))?"
)
_NO_SECRET = re.compile(r"\$\{?\w+\}?|<[^<>]*>|\[\w+\]|none|null|no|off|on|yes|true|false|auto|", re.IGNORECASE)
"""Values that are not secrets: the name of a variable, a mark such as <pad>, and words of settings."""
_ASSIGNED = re.compile(
    rf"""(?P<name>{_SECRET})["']?\]?\s*(?::=|[:=](?!=))\s*(?:(?:bearer|basic|token)\s+(?=\w))?"""
    r"""(?P<value>[bfru]{0,2}(?:"(?:[^"\\\n]|\\.)*"|'(?:[^'\\\n]|\\.)*')|[^\s"'&;,)\]}]+)(?=(?P<after>\s*[|=]\s)?)""",
    re.IGNORECASE,
)
_OPTION = re.compile(rf"(--[\w-]*{_SECRET}\s+)(?!--)\S+", re.IGNORECASE)
_CODE = re.compile(r"None|str|bytes|int|[A-Za-z_][\w.]*[(\[].*|self\.\w+|os\.\w.*")
_SECRETS = (
    re.compile(
        r"(?<=://)(?:(?![\w.-]+:\d{1,5}/)[^/\s@]*:\S*|(?:(?<=http://)|(?<=https://))[^/\s@?#]+)(?=@)"
        r"|-----BEGIN [A-Z ]*PRIVATE KEY-----.*?(?:-----END [A-Z ]*-----|\Z)",
        re.DOTALL,
    ),
    re.compile(
        r"\b(?:gh[a-z]_\w{12,}|(?:github_pat_|glpat-|xox[a-z]-|pypi-)[\w-]{12,}|(?:hf|npm)_[A-Za-z0-9]{12,}"
        r"|sk-(?=[\w-]*\d)[\w-]{12,}|AKIA[A-Z0-9]{12,}|AIza[\w-]{30,}|eyJ[\w-]{10,}\.[\w-]+\.[\w-]+)"
    ),
)
"""User and password in a URL, keys, and tokens of well-known services."""


def is_secret(key: str) -> bool:
    """Whether a setting or an option of this name holds a secret."""
    return re.search(rf"{_SECRET}$", key, re.IGNORECASE) is not None


def redact(text: str) -> str:
    """Replace each text that looks like a secret by `***`; in doubt, too much is replaced."""
    for pattern in _SECRETS:
        text = pattern.sub("***", text)
    return _OPTION.sub(r"\1***", _ASSIGNED.sub(_hidden, text))


def _hidden(found: re.Match[str]) -> str:
    """A name with `***` as its value, unless this is a number of tokens, a variable, or code."""
    name, value = found["name"].lower(), found["value"]
    number = name in ("token", "tokens", "pass") and re.fullmatch(r"[\[\d.e+-]+", value)
    kind = found["after"] and value.isalpha() and value[0].isupper()  # token: Token | None
    plain = _NO_SECRET.fullmatch(value.strip("\"'")) or _CODE.fullmatch(value)
    if number or kind or plain or value.rpartition(".")[2].lower() == name:
        return found[0]
    return f"{found[0].removesuffix(value)}***"


def recorded(value: Any, key: str = "", *, folders: bool = True) -> Any:
    """JSON as records hold it: with `***` in place of secrets, and maybe without folders of paths."""
    if isinstance(value, Mapping):
        return {name: recorded(one, name, folders=folders) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [recorded(one, key, folders=folders) for one in value]
    if not isinstance(value, str):
        return value
    text = "***" if is_secret(key) and not _NO_SECRET.fullmatch(value) else redact(value)
    return text if folders else without_folders(text)


def without_folders(text: str) -> str:
    """The text with .../name in place of each absolute path, because folders show machines and users."""
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
    """Class and first line of any exception."""
    try:
        lines = str(error).strip().splitlines()
    except Exception:  # __str__ may raise anything
        lines = []
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__


def closest(name: str, allowed: Iterable[str]) -> str | None:
    """The allowed name that is most like `name`, if one is similar enough."""
    lowered = {candidate.lower(): candidate for candidate in allowed}
    found = get_close_matches(name.lower(), lowered, n=1, cutoff=0.6)
    return lowered[found[0]] if found else None


def alternatives(name: str, allowed: Iterable[str], *, what: str = "allowed") -> str:
    """A hint for a name that is not allowed: the closest match, and the allowed names."""
    listed = list(allowed)
    match = closest(name, listed)
    listing = f"{what}: {', '.join(listed) or 'none'}"
    return f"did you mean {match!r}? {listing}" if match else listing


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
    """A broken plugin: a file is missing, it cannot be imported, its name is taken, or it breaks its interface."""

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
