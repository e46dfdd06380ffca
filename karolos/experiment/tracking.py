"""Sends runs to the tracker of a team, as one of several listeners. The run folder stays the truth.

A spec's `tracking` or KAROLOS_TRACKING names the tracker. An error of the tracker is a warning and loses no run. A
resumed run continues the same tracked run, which first gets its missing tests.
"""

from __future__ import annotations

import os
import re
import shlex
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from ..errors import KarolosError, MachineError, UsageError, described, recorded
from ..records import RunFolder
from ..records.evaluation import Evaluation
from ..specification.model import TRACKERS
from ..specification.tree import leaves
from .events import Listener, RunEnded, RunEvent, RunFinalTested, RunStarted, RunTested, RunWarned

VARIABLE, PROJECT = "KAROLOS_TRACKING", "KAROLOS_PROJECT"
"""Environment variables with the tracker of all runs and with its project (default: "karolos")."""
FILES = ("spec.yaml", "resolved.json", "run.json", "events.jsonl", "tests.jsonl", "final.jsonl")
"""Artefacts of a run. code.diff is not sent: a tracker may be public."""


@dataclass(frozen=True)
class Tracked:
    """Description of a run for a tracker."""

    id: str
    name: str
    """Name of its experiment."""
    project: str
    runs: Path
    """The runs folder. Trackers keep their files there, unless their own variables name another place."""
    settings: dict[str, Any]
    """Settings by key path, without secrets."""

    @classmethod
    def of(cls, folder: RunFolder) -> Tracked:
        about = folder.description()
        settings = {".".join(path): value for path, value in leaves(recorded(folder.read_spec() or {}))}
        known = {"experiment": about["experiment"], "seed": about["seed"], **settings}
        project = os.environ.get(PROJECT) or "karolos"
        return cls(folder.id, about["name"], project, folder.path.resolve().parent, known)

    @property
    def group(self) -> str:
        """The runs of a sweep's trials and of an experiment's seeds are one group."""
        return re.sub(r"-t\d+$", "", self.name)


class Tracker(ABC):
    """One run in a tracker, created when the run starts or resumes. It may raise any error of its library."""

    known: set[int]
    """Steps of the tests that it already has: a resumed run may play some again."""

    @abstractmethod
    def __init__(self, run: Tracked) -> None:
        """Begin the tracked run, or continue the one with the run's id. Sets `known`."""

    @abstractmethod
    def add(self, points: Mapping[str, float], steps: int) -> None:
        """Add points after these environment steps."""

    def add_test(self, result: Evaluation) -> None:
        """Add a test, unless it is known."""
        if result.steps not in self.known:
            self.add(_points(result, "test"), result.steps)
            self.known.add(result.steps)

    @abstractmethod
    def add_files(self, files: list[Path]) -> None:
        """Keep files of the run folder."""

    @abstractmethod
    def end(self, state: str) -> None:
        """The run is finished, stopped or failed."""


def tracker_of(folder: RunFolder) -> str | None:
    """The name of a run's tracker: that of its spec, or of all runs."""
    name: str | None = (folder.read_spec() or {}).get("tracking") or os.environ.get(VARIABLE)
    return name


def open_tracker(name: str, folder: RunFolder) -> Tracker:
    """A tracker with all tests that the folder holds.

    Raises:
        UsageError: there is no such tracker.
        MachineError: its package is missing.
    """
    if name not in TRACKERS:
        raise UsageError(f"there is no tracker {name!r}", hint=f"choose {', '.join(TRACKERS)}")
    try:
        kind: type[Tracker] = getattr(import_module(f".{name}_tracker", __package__), f"{name.title()}Tracker")
        tracker = kind(Tracked.of(folder))
    except ImportError as error:
        raise MachineError(f"the package {error.name} is missing", hint=f"pip install 'karolos[{name}]'") from error
    for result in folder.tests():
        tracker.add_test(result)
    return tracker


def push(name: str, folder: RunFolder) -> None:
    """Send the content of a run folder. The tracker keeps its data. Raises as `open_tracker` and as its library."""
    tracker = open_tracker(name, folder)
    if final := folder.final():
        tracker.add(_points(final["last"], "final"), final["last"].steps)
    _end(tracker, folder, folder.state().state)


def _points(test: Evaluation, group: str) -> dict[str, float]:
    values = {"return": test.mean_return, "success_end": test.success_end, "success_any": test.success_any}
    values |= {name: one["mean"] for name, one in test.measures.items()}
    return {f"{group}/{name}": value for name, value in values.items() if value is not None}


def _end(tracker: Tracker, folder: RunFolder, state: str) -> None:
    tracker.add_files([folder.path / name for name in FILES if (folder.path / name).is_file()])
    tracker.end(state)


@dataclass
class Tracking:
    """A listener that passes events on, and sends each run to the tracker that its spec or the environment names."""

    listener: Listener
    _runs: dict[str, tuple[RunFolder, Tracker]] = field(default_factory=dict, init=False)

    def __call__(self, event: RunEvent) -> None:
        self.listener(event)
        try:
            self._track(event)
        except Exception as error:  # the tracker's library or the network failed
            found = self._runs.pop(event.run, None)
            path = Path(event.folder) if isinstance(event, RunStarted) else found and found[0].path
            elsewhere = path is not None and path.resolve().parent != Path("runs").resolve()
            place = f" --runs {shlex.quote(str(path.parent))}" if path is not None and elsewhere else ""
            what = str(error) if isinstance(error, KarolosError) else described(error)
            consequence = f"the run goes on; `karolos runs push {event.run}{place}` sends it later"
            self.listener(RunWarned(event.run, f"the tracker failed: {what} ({consequence})"))

    def _track(self, event: RunEvent) -> None:
        if isinstance(event, RunStarted):
            folder = RunFolder.open(event.folder)
            if name := tracker_of(folder):
                self._runs[event.run] = folder, open_tracker(name, folder)
        elif (found := self._runs.get(event.run)) is None:
            return
        elif isinstance(event, RunTested):
            found[1].add_test(event.result)
        elif isinstance(event, RunFinalTested):
            found[1].add(_points(event.final["last"], "final"), event.final["last"].steps)
        elif isinstance(event, RunEnded):
            del self._runs[event.run]
            _end(found[1], found[0], event.state)
