"""The interface of launchers, which start the processes that execute folders."""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from pathlib import Path
from typing import ClassVar, NamedTuple

COMMAND = (sys.executable, "-P", "-m", "karolos.experiment.process")
"""The command of a process. Its arguments are `--cores`, the number of cores, and the folder of a run or a test."""


class Ended(NamedTuple):
    """A folder that is no longer executed."""

    folder: Path
    problem: str | None = None
    """Why it did not end by itself, e.g. "its process was killed by SIGKILL". None: it did."""
    died: bool = False
    """Whether its process died, so that another one may continue."""


class Launcher(ABC):
    """Executes runs in processes, on this machine or on others. A context manager.

    A plugin has nested `Settings` and is made with them and the largest number of runs at the same time (None: the
    launcher's own limit).

    Runs. A run is a folder that contains everything its process needs. The process is `COMMAND --cores N FOLDER`, or
    COMMAND without a folder, which imports libraries once and executes the folders that come on its stdin. A run that
    has begun is resumed. All processes see the folder under the same path. A zero-shot test of a policy is a folder,
    too, and is executed in the same way. A launcher does not distinguish the two.

    Results. A launcher reports only that a run has ended. Everything else stands in the run's folder: state.json,
    events.jsonl, tests.jsonl and progress.json.

    Stops. The file `stop` in a run's folder holds the reason why the run has to write a checkpoint and end. A process
    that its launcher started also does so when the launcher's process has ended.
    """

    poll_seconds: ClassVar[float] = 0.2
    """Time between two checks of the run folders."""
    library: ClassVar[str | None] = None
    """A module that must be installed, and the extra of karolos that installs it."""

    @abstractmethod
    def room(self, waiting: int) -> int:
        """Number of `waiting` runs that can start now. May begin to prepare processes. Does not wait."""

    @abstractmethod
    def start(self, folder: Path) -> None:
        """Start or resume a run. There must be room for it. Does not wait."""

    @abstractmethod
    def wait(self, seconds: float) -> Ended | None:
        """Wait at most this long for a run to end. Each started run is returned once."""

    @abstractmethod
    def close(self, *, kill: bool) -> None:
        """End all processes: idle ones at once, the others after a checkpoint or, with `kill`, at once."""

    def __enter__(self) -> Launcher:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.close(kill=kind is not None and not issubclass(kind, Exception))
