"""Promises and the plugins that are checked for them. No test framework is needed."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydantic import ValidationError

from ...errors import UsageError
from ...registry import load, singular
from ...simulation.engines import Engine


@dataclass(frozen=True)
class Candidate:
    """A plugin to check: kind and name as in the registry, and the settings that differ from the defaults.

    `engine` simulates a robot or a task; None: the environment's default.
    """

    kind: str
    name: str
    plugin: type[Any]
    settings: Mapping[str, Any] = field(default_factory=dict)
    engine: Engine | None = None

    def settled(self, **more: Any) -> Any:
        """The plugin's settings, with `more` on top.

        Raises UsageError if a setting without a default is missing, or a value is invalid.
        """
        try:
            return self.plugin.Settings.model_validate({**self.settings, **more})
        except ValidationError as error:
            first = error.errors()[0]
            place = ": ".join([f"{singular(self.kind)} {self.name}", *map(str, first["loc"])])
            shown = f"`karolos plugins show {singular(self.kind)} {self.name}`"
            what = "no such setting" if first["type"] == "extra_forbidden" else first["msg"]
            raise UsageError(what, where=place, hint=f"{shown} lists the settings; give one as NAME=VALUE") from None


def required(plugin: type[Any]) -> list[str]:
    """The settings of a plugin that have no default."""
    return [name for name, one in plugin.Settings.model_fields.items() if one.is_required()]


def candidate(kind: str, name: str, engine: Engine | None = None, **settings: Any) -> Candidate:
    """An installed plugin. Raises UsageError or PluginError as `registry.load`."""
    return Candidate(kind, name, load(kind, name), settings, engine)


@dataclass(frozen=True)
class Case:
    """A promise with the plugins for which a call checks it.

    Raises AssertionError if the promise is broken; the message is one line.
    """

    promise: Callable[..., None]
    candidates: tuple[Candidate, ...]
    group: Promises

    def __call__(self) -> None:
        if self.group.opened is None:
            self.promise(*self.candidates)
            return
        with self.group.opened(*self.candidates) as subject:
            self.promise(subject)

    def __str__(self) -> str:
        who = [
            text for one in self.candidates for text in (one.name, *map(str, one.settings.values()), one.engine) if text
        ]
        return f"{'-'.join(who)}-{self.promise.__name__}"

    @property
    def text(self) -> str:
        """The promise as a sentence."""
        return (inspect.getdoc(self.promise) or "").partition("\n\n")[0].replace("\n", " ")


class Promises(list[Callable[..., None]]):
    """Promises in the order in which they are checked. As a decorator it adds one.

    `opened` builds the subject of the promises; None: they get the candidates. All others depend on `basic` ones.
    """

    def __init__(
        self, opened: Callable[..., AbstractContextManager[Any]] | None = None, *, basic: bool = False
    ) -> None:
        super().__init__()
        self.opened, self.basic = opened, basic

    def __call__(self, promise: Callable[..., None]) -> Callable[..., None]:
        self.append(promise)
        return promise

    def cases(self, *candidates: Candidate) -> list[Case]:
        return [Case(promise, candidates, self) for promise in self]


def demand(holds: object, otherwise: str) -> None:
    """Raise AssertionError with this message unless `holds` is true."""
    if not holds:
        raise AssertionError(otherwise)


def demand_same(first: object, second: object, what: str) -> None:
    """Raise AssertionError unless two arrays, or values that become arrays, are equal bit for bit."""
    one, other = np.asarray(first), np.asarray(second)
    demand(one.shape == other.shape, f"{what} differ in shape: {one.shape} and {other.shape}")
    if not np.array_equal(one, other):
        place = tuple(int(index) for index in np.argwhere(np.atleast_1d(one != other))[0])
        raise AssertionError(f"{what} differ: {np.atleast_1d(one)[place]} and {np.atleast_1d(other)[place]} at {place}")


def demand_shape(found: Any, shape: tuple[int, ...], what: str, dtype: type[np.generic] | None = None) -> None:
    """Raise AssertionError unless an array has this shape and, if given, this dtype."""
    demand(found.shape == shape, f"{what} has the shape {found.shape} instead of {shape}")
    demand(dtype in (None, found.dtype), f"{what} is {found.dtype} instead of {np.dtype(dtype)}")


def demand_same_fields(first: Any, second: Any, what: str) -> None:
    """Raise AssertionError unless the fields of two named tuples are equal bit for bit."""
    for name, one, other in zip(first._fields, first, second, strict=True):
        demand_same(one, other, f"{name} of {what}")


def demand_same_state(first: object, second: object, what: str, hint: str) -> None:
    """Raise AssertionError with the paths at which two nested states differ."""
    paths = state_differences(first, second)
    demand(not paths, f"{what} at {paths}: {hint}")


def demand_refusal(call: Callable[[], object], error: type[Exception], otherwise: str) -> None:
    """Raise AssertionError with the message `otherwise` unless the call raises this error."""
    try:
        call()
    except error:
        return
    raise AssertionError(otherwise)


def state_differences(one: object, other: object, *, ignore: frozenset[str] = frozenset(), path: str = "") -> list[str]:
    """Key paths at which two nested states of dicts, lists and arrays differ. NaN equals NaN.

    `ignore`: keys of dicts that are not compared. `path`: prefix of the key paths.
    """
    if isinstance(one, dict) and isinstance(other, dict):
        if one.keys() != other.keys():
            return [f"{path}: {sorted(map(str, one))} and {sorted(map(str, other))}"]
        pairs = [(f"{path}.{key}", one[key], other[key]) for key in one if key not in ignore]
    elif isinstance(one, list | tuple) and isinstance(other, list | tuple):
        if len(one) != len(other):
            return [f"{path}: {len(one)} and {len(other)} entries"]
        pairs = [(f"{path}[{index}]", *pair) for index, pair in enumerate(zip(one, other, strict=True))]
    else:
        first, second = np.asarray(one), np.asarray(other)
        return [] if np.array_equal(first, second, equal_nan=first.dtype.kind == "f") else [path]
    return [found for key, a, b in pairs for found in state_differences(a, b, ignore=ignore, path=key)]
