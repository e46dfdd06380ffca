"""Writes a run into its folder (the truth), then into the store (an index), and tells the listener."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from typing import Any

from ..core import Failure
from ..errors import KarolosError, MachineError, StoreError
from ..records import RunFolder, provenance
from ..records.evaluation import Evaluation
from ..records.run_records import StateName
from ..store import Store
from ..training.collecting import Episode
from ..training.training import Progress, Training
from .events import Listener, RunAdvanced, RunBusy, RunWarned
from .resume import Snapshot, learner_of

ADVANCE_SECONDS = 0.1
"""Minimal time between two RunAdvanced or two RunBusy events."""
WRITE_SECONDS = 4.0
"""Time after which the progress is written again: a reader sees a new value every five seconds."""


def index_run(url: str | None, folder: RunFolder) -> None:
    """Enter the state of a run's folder into the database. Without a URL another process does it. Raises StoreError."""
    if url is not None:
        with Store(url) as store:
            store.add_records([folder.record()])


@dataclass(frozen=True)
class Ending:
    """How a run ended."""

    state: StateName
    """finished, stopped or failed."""
    amounts: Mapping[str, Any] = field(default_factory=dict)
    """Steps, seconds and updates of training; empty if training was aborted."""
    reason: str | None = None
    error: str | None = None
    traceback: str | None = None
    """Traceback of the error, if karolos or a plugin is at fault."""


@dataclass
class RunWriter:
    """Writes state, events, tests and episodes of one run, and tells the listener warnings and progress.

    Every method raises MachineError if the folder cannot be written. Errors of the database are warnings only.
    """

    folder: RunFolder
    url: str | None
    """None: another process indexes the run."""
    listener: Listener
    training: Training | None = field(default=None, init=False)
    """The training whose progress is written; None before it exists."""
    _advanced: float = field(default=0.0, init=False)
    _busy: float = field(default=0.0, init=False)
    """Times of the last RunAdvanced and RunBusy event."""
    _written: float = field(default_factory=time.monotonic, init=False)

    def announce(self, activity: str, done: int, total: int) -> None:
        """Report the progress of a test or another activity."""
        now = time.monotonic()
        if done in (0, total) or now - self._busy >= ADVANCE_SECONDS:
            self._busy = now
            self.listener(RunBusy(self.folder.id, activity, done, total))
            self._write_progress(now)

    def progressed(self, progress: Progress, *, last: bool) -> None:
        """A round of training is over; `last`: it was the last one."""
        now = time.monotonic()
        if last or now - self._advanced >= ADVANCE_SECONDS:
            self._advanced = now
            counts = progress.steps, progress.updates, progress.episodes
            self.listener(RunAdvanced(self.folder.id, *counts, progress.seconds, progress.warming_up))
            self._write_progress(now)

    def _write_progress(self, now: float) -> None:
        """Write the progress of training, for display. Errors of writing are ignored here and noticed elsewhere."""
        if self.training is not None and now - self._written >= WRITE_SECONDS:
            self._written = now
            with suppress(MachineError):
                self.folder.set_progress(**self.training.totals())

    def warn(self, warning: str, consequence: str) -> None:
        """Write a problem that the run survives, and tell the listener."""
        self.folder.event("warning", error=warning, consequence=consequence)
        self.listener(RunWarned(self.folder.id, f"{warning} ({consequence})"))

    def warn_of_failure(self, failure: Failure) -> None:
        """Environments failed and begin their episodes again."""
        environments = ", ".join(map(str, failure.environment.tolist()))
        self.warn(str(failure.error), f"the episodes of these environments start again: {environments}")

    @contextmanager
    def tolerated(self, kind: type[KarolosError], consequence: str) -> Iterator[None]:
        """Turn an error of this kind into a warning."""
        try:
            yield
        except kind as error:
            self.warn(str(error), consequence)

    def start(self, snapshot: Snapshot | None, learner: Mapping[str, str], *, exact: bool) -> None:
        """The run starts, or resumes from a snapshot: bit for bit if `exact`, with the same software and `learner`."""
        if snapshot is None:
            self._set_state("running")
            self.folder.event("started", **learner)
            for name in provenance.edited_since_import(self.folder.description().get("sources") or {}):
                what = f"the source of {name} was edited after this process imported it"
                self.warn(what, "the run may use the old code, and its record has the new one; start the process again")
            return
        about = self.folder.description()
        found = provenance.other_software(about)
        consequence = "it may differ from an unbroken run"
        if found:
            self.warn(f"it began with other software: {'; '.join(found)}", consequence)
        before = learner_of(self.folder)
        other = [f"{name} {now} after {before[name]}" for name, now in learner.items() if before.get(name, now) != now]
        if other:
            self.warn(f"it learns on another machine: {', '.join(other)}", consequence)
        exact = exact and not found and not other
        if not exact:
            self.folder.cut_tests(snapshot.meta["steps"])
        self._set_state("running")
        attempt = self.folder.state().attempt
        self.folder.event("resumed", attempt=attempt, steps=snapshot.meta["steps"], bit_exact=exact, **learner)
        self.folder.cut_episodes(snapshot.meta["episodes_bytes"])

    def write_episodes(self, episodes: Sequence[Episode], parameters: Sequence[str]) -> None:
        """Record training episodes, with the sampled values of domain randomization under the parameters' names."""
        rows = []
        for episode in episodes:
            values = asdict(episode)
            drawn = dict(zip(parameters, values.pop("parameters"), strict=True))
            rows.append(values | ({"parameters": drawn} if drawn else {}))
        if rows:
            self.folder.add_episodes(rows)

    def write_test(self, training: Training, result: Evaluation) -> None:
        """A test is over. Training may have gone on since it was due."""
        self.folder.add_test(result)
        self.folder.set_state("running", **training.totals())
        with self.tolerated(StoreError, "the test is in the run folder, but not in the database"):
            index_run(self.url, self.folder)

    def write_final(self, final: Mapping[str, Evaluation]) -> None:
        self.folder.write_final(final)
        numbers = {name: one.counts.encode() for name, one in final.items()}
        self.folder.event("final_test", seed=final["last"].seed, last=numbers["last"], best=numbers.get("best"))

    def end(self, ending: Ending) -> None:
        """The run is over. Environments are closed."""
        if ending.error is not None:
            self._set_state(ending.state, error=ending.error.splitlines()[0])
            self.folder.event(ending.state, error=ending.error, traceback=ending.traceback)
            return
        self._set_state(ending.state, **ending.amounts)
        details = {"steps": ending.amounts.get("steps"), "reason": ending.reason}
        self.folder.event(ending.state, **{key: value for key, value in details.items() if value is not None})

    def _set_state(self, state: StateName, **more: Any) -> None:
        self.folder.set_state(state, **more)
        with self.tolerated(StoreError, "the run continues; its folder is complete"):
            index_run(self.url, self.folder)
