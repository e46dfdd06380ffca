"""The installed plugins: lists them by name without an import, and imports one at a time.

A plugin is a class behind an entry point of the group `karolos.<kind>`, whether it is karolos's own or a third
party's. Its settings are a nested pydantic model called `Settings`.
"""

from __future__ import annotations

import importlib.metadata
import os
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

from .errors import KarolosError, MachineError, PluginError, UsageError, alternatives

KINDS = (
    "robots",
    "grippers",
    "tasks",
    "environments",
    "agents",
    "buffers",
    "distributions",
    "orchestrators",
    "launchers",
)

GROUPS = {f"karolos.{kind}": kind for kind in KINDS}
"""Group of entry points -> its kind."""
LARGEST = 1_000_000
"""Largest size of a file of entry points in bytes."""

NEEDED_ATTRIBUTES = {
    "robots": ("prepare", "build", "apply", "reset", "act", "read", "observe"),
    "grippers": ("model",),
    "tasks": ("fit", "build", "reset", "observe", "achieved"),
    "environments": ("reset", "step", "close"),
    "agents": ("on_policy", "act", "learn", "check", "state", "load_state"),
    "buffers": ("on_policy", "add", "cut", "sample", "state", "load_state"),
    "distributions": ("draw",),
    "orchestrators": ("reset", "step", "receive", "close"),
    "launchers": ("room", "start", "wait", "close"),
}
"""Attributes that a class of each kind must have, even if it does not inherit from karolos's interface."""


@dataclass(frozen=True)
class PluginEntry:
    """A plugin as its distribution declares it, without importing it."""

    kind: str
    name: str
    target: str
    """The class, as "module:Class"."""
    distribution: str
    version: str

    @property
    def package(self) -> str:
        """The outermost package or the module that holds it."""
        return _package(self.target)

    @property
    def who(self) -> str:
        """The plugin in messages."""
        return f"{singular(self.kind)} {self.name!r} of {self.distribution} {self.version}"


def singular(kind: str) -> str:
    """The name of a kind in specs and messages: "robot" for "robots"."""
    return kind.removesuffix("s")


def entries(kind: str) -> tuple[PluginEntry, ...]:
    """The installed plugins of a kind, by name; a name that two distributions claim is listed twice.

    Raises:
        UsageError: the kind is unknown.
    """
    if kind not in KINDS:
        raise UsageError(f"no kind of plugin is called {kind!r}", hint=alternatives(kind, KINDS))
    return tuple(entry for entry in _installed() if entry.kind == kind)


def names(kind: str) -> list[str]:
    """The names of a kind's installed plugins, sorted."""
    return sorted({entry.name for entry in entries(kind)})


def load(kind: str, name: str) -> Any:
    """Import a plugin's class.

    Raises:
        UsageError: the kind or the name is unknown; lists the known ones and the closest match.
        PluginError: two distributions claim the name, the plugin does not import, it has no usable `Settings`, or it
            lacks a part of its kind's interface.
        MachineError: there is not enough memory to import it.
    """
    return _load(find(kind, name))


def loaded(kind: str, name: object) -> Any:
    """The plugin's class; None if it is missing or broken. `load` raises the error instead."""
    try:
        return load(kind, name) if isinstance(name, str) else None
    except (UsageError, PluginError):
        return None


def find(kind: str, name: str) -> PluginEntry:
    """The plugin of that kind and name, without importing it. Raises as `load` does."""
    found = [entry for entry in entries(kind) if entry.name == name]
    if not found:
        hint = "; ".join((alternatives(name, names(kind), what=f"installed {kind}"), *unreadable()))
        raise UsageError(f"no {singular(kind)} is called {name!r}", hint=hint)
    if len(found) > 1:
        claims = " and ".join(entry.distribution for entry in found)
        what = f"{singular(kind)} {name!r} is claimed by {claims}"
        raise PluginError(what, plugin=(kind, name), hint="uninstall one of them")
    return found[0]


def _installed() -> tuple[PluginEntry, ...]:
    return _scan()[0]


def unreadable() -> tuple[str, ...]:
    """A line for each installed distribution with unreadable entry points: its plugins are unknown."""
    return _scan()[1]


def _points(dist: importlib.metadata.Distribution) -> importlib.metadata.EntryPoints:
    """The entry points of a distribution. Raises any error that its files cause."""
    place = getattr(dist, "_path", None)  # a zip file or a special importer may have none
    file = str(place / "entry_points.txt") if place else ""
    if os.path.exists(file) and not (os.path.isfile(file) and os.path.getsize(file) <= LARGEST):
        raise OSError(f"not a plain file of at most {LARGEST:,} bytes")
    return _ENTRY_POINTS(dist)


def _readable_points(dist: importlib.metadata.Distribution) -> importlib.metadata.EntryPoints:
    try:
        return _points(dist)
    except Exception:  # a file may have any content
        return importlib.metadata.EntryPoints(())


_ENTRY_POINTS: Callable[[object], importlib.metadata.EntryPoints] = importlib.metadata.Distribution.entry_points.fget  # type: ignore[attr-defined]
# pydantic, numba and gymnasium ask every distribution as well: a file that cannot be read would end them all.
importlib.metadata.Distribution.entry_points = property(_readable_points)  # type: ignore[assignment,method-assign]


@cache
def _scan() -> tuple[tuple[PluginEntry, ...], tuple[str, ...]]:
    """All plugins, and a line for each unreadable file. It takes 20 ms, so it is done once per process."""
    found: dict[str, set[PluginEntry]] = {}  # if a distribution has two copies, the first one on Python's path counts
    problems: list[str] = []
    for dist in importlib.metadata.distributions():
        place = getattr(dist, "_path", dist)
        try:
            points = [
                (GROUPS[point.group], point.name, point.value) for point in _points(dist) if point.group in GROUPS
            ]
        except Exception as error:  # a file may have any content
            problems.append(f"{place}: its entry points cannot be read: {_text(error)}")
            continue
        name, _, version = getattr(place, "stem", "?").partition("-")
        if points:
            with suppress(Exception):  # METADATA may be missing
                name, version = dist.metadata["Name"] or name, dist.metadata["Version"] or version
            found.setdefault(name, {PluginEntry(*point, name, version) for point in points})
    order = sorted(set().union(*found.values()), key=lambda one: (KINDS.index(one.kind), one.name, one.distribution))
    return tuple(order), tuple(problems)


_in_use: set[PluginEntry] = set()
"""The plugins that this process has imported."""


@cache
def _load(entry: PluginEntry) -> Any:
    point = importlib.metadata.EntryPoint(entry.name, entry.target, f"karolos.{entry.kind}")
    broken = partial(PluginError, plugin=(entry.kind, entry.name))
    try:
        with redirect_stdout(sys.stderr):
            plugin = point.load()
            _check(plugin, entry.kind, partial(broken, where=entry.who))
    except (PluginError, KeyboardInterrupt):
        raise
    except MemoryError:  # not the plugin's fault
        raise MachineError(f"not enough memory to import {entry.who}", hint="free memory, or raise its limit") from None
    except BaseException as error:  # a plugin's module may raise anything
        if isinstance(error, SyntaxError) and os.path.isfile(error.filename or ""):
            place = f"{error.filename}:{error.lineno}: "
        else:
            package, own = _package(entry.target), f"{__name__}:"
            inside = (at for name, at in _frames(error) if _package(name) == package and not name.startswith(own))
            place = next((f"{at}: " for at in inside), "")
        hint = f"repair {entry.target}, or uninstall {entry.distribution}"
        if entry.distribution == "karolos":
            hint = "free memory if there is too little, or install karolos and its libraries again"
        # `from None`: the command line would print the traceback of a cause, but the place is enough
        raise broken(f"does not import: {_text(error)}", where=place + entry.who, hint=hint) from None
    _in_use.add(entry)
    return plugin


@contextmanager
def blaming() -> Iterator[None]:
    """Turn an error in the code of a third party's plugin into a PluginError at the plugin's line.

    Other errors are bugs in karolos and do not change.
    """
    try:
        yield
    except KarolosError:
        raise
    except Exception as error:  # a plugin may raise anything
        if (theirs := blamed(error)) is not None:
            raise theirs from None
        raise


def blamed(error: BaseException) -> PluginError | None:
    """The error as that of a third party's plugin, at its innermost line. None if it passed through no such plugin."""
    theirs = [entry for entry in _installed() if entry.distribution != "karolos"]
    for name, place in _frames(error):
        found = [entry for entry in theirs if entry.package == _package(name)]
        if found:  # if a package has several, one in use, with the most similar module and class
            found = [entry for entry in found if entry in _in_use] or found
            entry = max(found, key=lambda one: len(os.path.commonprefix([f"{one.target}.", name])))  # noqa: RUF071
            return PluginError(_text(error), where=f"{place}: {entry.who}", plugin=(entry.kind, entry.name))
    return None


def _frames(error: BaseException) -> list[tuple[str, str]]:
    """Function, as "module:Class.method.", and file:line of each frame of an error, the innermost first."""
    return [
        (f"{frame.f_globals.get('__name__')}:{frame.f_code.co_qualname}.", f"{frame.f_code.co_filename}:{line}")
        for frame, line in traceback.walk_tb(error.__traceback__)
    ][::-1]


def _package(name: str) -> str:
    """The outermost package of "package.module:Class"."""
    return name.partition(":")[0].partition(".")[0]


def _text(error: BaseException) -> str:
    """Class and first line of any exception, even if its __str__ raises; with Python's "Did you mean"."""
    return traceback.format_exception_only(error)[-1].splitlines()[0]


def _check(plugin: object, kind: str, broken: Callable[..., PluginError]) -> None:
    from pydantic import BaseModel  # noqa: PLC0415  (30 ms that listing names does not need)

    settings = getattr(plugin, "Settings", None)
    if not isinstance(plugin, type):
        raise broken("is not a class", hint="the entry point must name the plugin's class")
    if not (isinstance(settings, type) and issubclass(settings, BaseModel)):
        raise broken("has no settings", hint="nest a pydantic model called Settings in the class")
    if "name" in settings.model_fields:
        raise broken("has a setting called 'name'", hint="rename it: in a spec `name` is the name of the plugin")
    abstract: frozenset[str] = getattr(plugin, "__abstractmethods__", frozenset())
    lacking = sorted({*abstract, *(name for name in NEEDED_ATTRIBUTES[kind] if not hasattr(plugin, name))})
    if lacking:
        what = f"{plugin.__name__} is no {singular(kind)}: it lacks {', '.join(lacking)}"
        raise broken(what, hint=f"{kind} have {', '.join(NEEDED_ATTRIBUTES[kind])}")
