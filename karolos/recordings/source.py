"""The common form of all formats: a recorded dataset as named columns, episode by episode."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..errors import MachineError, UsageError

SETTING = "demonstrations.file"
Columns = dict[str, NDArray[Any]]
"""Columns of one episode of n steps, by name: (n, k), or (n + 1, k) if the last state is recorded, too."""


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
