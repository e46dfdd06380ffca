"""A promise of a kind of plugin, and the plugin that is to keep it. Nothing here needs a test framework."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydantic import ValidationError

from ...errors import UsageError
from ...registry import load, singular

_HINT = "name settings that have no default or another value, e.g. low=0"


@dataclass(frozen=True)
class Candidate:
    """A plugin that is to be checked.

    Args:
        kind: of plugin, as the registry calls it: robots, tasks, ...
        name: what specs call it.
        plugin: its class.
        settings: other than its defaults.
    """

    kind: str
    name: str
    plugin: type[Any]
    settings: Mapping[str, Any] = field(default_factory=dict)

    def settled(self, **more: Any) -> Any:
        """Its settings.

        Raises:
            UsageError: a setting that has no default is missing, or one is not as it should be.
        """
        try:
            return self.plugin.Settings.model_validate({**self.settings, **more})
        except ValidationError as error:
            first = error.errors()[0]
            place = ": ".join([f"{singular(self.kind)} {self.name}", *map(str, first["loc"])])
            raise UsageError(first["msg"], where=place, hint=_HINT) from None


def candidate(kind: str, name: str, **settings: Any) -> Candidate:
    """An installed plugin. Raises UsageError or PluginError as `registry.load`."""
    return Candidate(kind, name, load(kind, name), settings)


@dataclass(frozen=True)
class Case:
    """A promise and who is to keep it; call it to see whether that is so.

    Raises:
        AssertionError: it is not; says what is wrong in one line.
    """

    promise: Callable[..., None]
    candidates: tuple[Candidate, ...]

    def __call__(self) -> None:
        self.promise(*self.candidates)

    def __str__(self) -> str:
        who = [text for one in self.candidates for text in (one.name, *map(str, one.settings.values()))]
        return f"{'-'.join(who)}-{self.promise.__name__}"

    @property
    def text(self) -> str:
        """The promise as a sentence."""
        return (inspect.getdoc(self.promise) or "").partition("\n\n")[0].replace("\n", " ")


def cases_of(promises: Iterable[Callable[..., None]], *candidates: Candidate) -> list[Case]:
    """One case per promise."""
    return [Case(promise, candidates) for promise in promises]


def demand(holds: object, otherwise: str) -> None:
    """Raise AssertionError with these words unless it holds."""
    if not holds:
        raise AssertionError(otherwise)


def demand_same(first: object, second: object, what: str) -> None:
    """Raise AssertionError unless two arrays, or what can be made one, are equal bit for bit."""
    one, other = np.asarray(first), np.asarray(second)
    demand(one.shape == other.shape, f"{what}: the shapes are {one.shape} and {other.shape}")
    if not np.array_equal(one, other):
        place = tuple(int(index) for index in np.argwhere(np.atleast_1d(one != other))[0])
        raise AssertionError(f"{what}: {np.atleast_1d(one)[place]} and {np.atleast_1d(other)[place]} at {place}")


def demand_refusal(call: Callable[[], object], error: type[Exception], otherwise: str) -> None:
    """Raise AssertionError unless the call raises this error."""
    try:
        call()
    except error:
        return
    raise AssertionError(otherwise)
