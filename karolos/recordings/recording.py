"""A recorded episode, the meaning of its numbers, datasets of any format, and our own format.

Our own format is a folder that grows episode by episode:

recording.json   meaning of the numbers, see `describe`
episodes.jsonl   one line per played episode: index, seed, steps, success, and whether it was kept
episodes/        one .npz per kept episode
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from ..core import BoolArray, Discrete, Field, FloatArray, Layout, Signature
from ..environments.build import Facts, opened
from ..errors import MachineError, UsageError
from ..specification.parts import Recipe
from ..system.files import append_lines, read_lines, read_object, write_json, writing

FORMAT = 1
DESCRIPTION, EPISODES, FILES = "recording.json", "episodes.jsonl", "episodes"
STATES = ("observation", "achieved_goal", "desired_goal")
"""Arrays of an episode of n steps with n + 1 rows; the first row is that of the reset."""
NAMES = {name: name for name in (*STATES, "action", "reward", "terminated")}
"""Columns of our own format and of Minari."""
SETTING = "demonstrations.file"
Columns = dict[str, NDArray[Any]]
"""Columns of one episode of n steps, by name: (n, k), or (n + 1, k) if the last state is recorded, too."""


@dataclass(frozen=True)
class Recording:
    """An episode of n steps."""

    observation: FloatArray
    """(n + 1, o)"""
    achieved_goal: FloatArray
    """(n + 1, g)"""
    desired_goal: FloatArray
    """(n + 1, d)"""
    action: FloatArray
    """(n, a)"""
    reward: FloatArray
    """(n,)"""
    terminated: BoolArray
    """(n,)"""
    truncated: BoolArray
    """(n,)"""
    success: BoolArray
    """(n + 1,)"""
    seed: int = 0
    """Seed of the environment's reset."""

    @property
    def steps(self) -> int:
        return len(self.reward)


@dataclass(frozen=True)
class Played:
    """The outcome of one played episode of a recording."""

    index: int
    seed: int
    steps: int
    success: bool
    """Success at the last step."""
    kept: bool
    diverged: bool = False
    measures: Mapping[str, float] = field(default_factory=dict)
    """Measures by name, without undefined ones."""


def describe(recipe: Recipe, about: Mapping[str, Any]) -> dict[str, Any]:
    """Meaning of the numbers of a recording, as JSON-able data.

    Args:
        recipe: of the environment. The first line of its task's docstring becomes `task`.
        about: origin of the recording.
    """
    with opened(recipe) as environment:
        facts = Facts.of(environment)
        doc = (type(getattr(environment, "task", environment)).__doc__ or "").strip().splitlines()
    signature = facts.signature
    return {
        "format": FORMAT,
        "rate": facts.rate,
        **{name: getattr(signature, name).described() for name in (*STATES, "action")},
        "scales": {name: [unit, list(moved)] for name, (unit, moved) in facts.scales.items()},
        "base": facts.base,
        "max_steps": signature.max_steps,
        **about,
        **({"task": doc[0].removeprefix("What to do: ").capitalize()} if doc else {}),
    }


def facts_of(about: Mapping[str, Any]) -> Facts:
    """The environment's facts in a description. Raises KeyError, TypeError or ValueError if it is damaged."""
    action = about["action"]
    signature = Signature(
        observation=_layout(about["observation"]),
        action=Discrete(tuple(action["labels"])) if isinstance(action, dict) else _layout(action),
        max_steps=int(about["max_steps"]),
        achieved_goal=_layout(about["achieved_goal"]),
        desired_goal=_layout(about["desired_goal"]),
    )
    scales = {name: (str(unit), tuple(map(float, moved))) for name, (unit, moved) in about["scales"].items()}
    return Facts(signature, float(about["rate"]), scales, about["base"])


def _layout(fields: list[dict[str, Any]]) -> Layout:
    return Layout(tuple(Field(str(one["name"]), int(one["size"]), str(one["unit"])) for one in fields))


def column_names(fields: list[dict[str, Any]] | dict[str, Any]) -> list[str]:
    """One name for each number of a described vector."""
    if isinstance(fields, dict):
        return ["action"]
    layout = _layout(fields)
    return [layout.column(place) for place in range(layout.size)]


@dataclass(frozen=True)
class Dataset:
    """A dataset that can be read."""

    path: Path
    lengths: tuple[int, ...]
    """Steps of each episode."""
    rate: float
    """Steps per second; 0 if the format does not say."""
    names: Mapping[str, str]
    """The format's columns for observation, achieved_goal, desired_goal, action and reward."""
    read: Callable[[int], Columns]
    """Function from an episode's number to its columns."""
    about: dict[str, Any] | None = None
    """Description in a dataset that karolos wrote, see `recording.describe`."""


def refuse(path: Path, what: str, hint: str | None = None) -> NoReturn:
    """Raise a UsageError about a dataset, or one of its files."""
    text = f"{path}: {what}"
    raise UsageError(text if text.isprintable() else ascii(text)[1:-1], setting=SETTING, hint=hint)


def require(package: str, extra: str, what: str) -> None:
    """Raise a MachineError if a package that a format needs is missing."""
    try:
        __import__(package)
    except ImportError as error:
        hint = f"pip install 'karolos[{extra}]'"
        raise MachineError(f"{what} needs the package {package}, which is missing", hint=hint) from error


def rows_of(values: Any) -> NDArray[Any]:
    """Numbers of an episode as (n, k). Raises ValueError or TypeError for anything else."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiub":
        raise TypeError(f"it holds {array.dtype}, not numbers")
    return array.reshape(len(array), -1)


@dataclass(frozen=True)
class RecordingFolder:
    """A recording in our own format, which may still grow. Raises MachineError when it cannot be written."""

    path: Path

    def begin(self, about: Mapping[str, Any]) -> None:
        with writing(self.path):
            (self.path / FILES).mkdir(parents=True, exist_ok=True)
        write_json(self.path / DESCRIPTION, about)

    def add(self, played: Played, recording: Recording) -> None:
        """Write an episode, and then its line: an episode without a line is written again."""
        if played.kept:
            path = self.file(played.index)
            with writing(path), path.open("wb") as file:
                np.savez(file, **vars(recording))
        append_lines(self.path / EPISODES, [vars(played)])

    def about(self) -> dict[str, Any] | None:
        """The description; None if there is none."""
        return read_object(self.path / DESCRIPTION)

    def played(self) -> list[Played]:
        """The episodes so far, in order."""
        return [Played(**row) for row in read_lines(self.path / EPISODES).rows]

    def file(self, index: int) -> Path:
        return self.path / FILES / f"{index:06}.npz"

    def recordings(self) -> Iterator[Recording]:
        """The kept episodes, in order, one in memory at a time."""
        for played in self.played():
            if played.kept:
                with np.load(self.file(played.index), allow_pickle=False) as file:
                    yield Recording(**{name: file[name] for name in file.files if name != "seed"}, seed=played.seed)


def read_own(path: Path) -> Dataset:
    """A recording in our own format. Raises UsageError if it is damaged."""
    folder = RecordingFolder(path)
    about = folder.about()
    try:
        kept = [one for one in folder.played() if one.kept]
        rate = float(about["rate"]) if about else 0.0
    except (KeyError, TypeError, ValueError):
        refuse(path, f"{DESCRIPTION} or {EPISODES} is damaged")

    def read(place: int) -> Columns:
        file = folder.file(kept[place].index)
        try:
            with np.load(file, allow_pickle=False) as arrays:
                found = {name: arrays[name] for name in arrays.files if name != "seed"}
        except (OSError, ValueError, EOFError, BadZipFile, zlib.error) as error:
            refuse(file, f"cannot be read: {error}", "copy it again")
        steps = kept[place].steps
        for name, array in found.items():
            if not array.ndim or len(array) not in (steps, steps + 1):
                refuse(file, f"{name} has the shape {array.shape}, and the episode {steps} steps", "copy it again")
        return {name: array.reshape(len(array), -1) for name, array in found.items()}

    return Dataset(path, tuple(one.steps for one in kept), rate, NAMES, read, about)
