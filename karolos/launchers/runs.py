"""The runs of a spec as a job of the driver: their folders are followed and entered into the database."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

from typing_extensions import override

from .. import system
from ..errors import RunError, StoreError, UsageError
from ..experiment.events import (
    RunAdvanced,
    RunBusy,
    RunEnded,
    RunEvent,
    RunFinalTested,
    RunLaunched,
    RunStarted,
    RunTested,
    RunWarned,
)
from ..experiment.resume import find_run
from ..experiment.writer import index_run
from ..records import RunFolder
from ..records.archive import remove_unfinished_imports
from ..records.decode import from_json
from ..records.evaluation import Evaluation, decode
from ..records.run_folder import remove_lost_leftovers
from ..records.run_records import UNFINISHED, RunSummary
from ..specification import Spec
from ..store import Store
from ..store.query import prepare_index
from ..system.files import new_lines, read_object
from .driver import FolderTask, Job

Existing = Literal["ignore", "skip", "resume"]


@dataclass(frozen=True)
class Home:
    """Where runs are kept, and what to do with existing ones."""

    runs: Path
    url: str
    """SQLAlchemy URL of the results database."""
    existing: Existing = "ignore"
    """As for `Experiment.run`."""
    text: str | None = None
    """The spec as its author wrote it."""

    @classmethod
    def prepared(cls, spec: Spec, runs: str | Path, database: str | None, existing: Existing) -> Home:
        """The home of a spec's runs, checked. Files that killed processes left in it are removed.

        Raises:
            UsageError: there is no such `existing`.
            MachineError: the runs folder cannot be written.
            StoreError: the database cannot be used.
        """
        if existing not in get_args(Existing):
            raise UsageError(f"there is no existing={existing!r}", hint=f"allowed: {', '.join(get_args(Existing))}")
        home = cls(Path(runs), database or Store.default_url(runs), existing)
        RunFolder.check_writable(home.runs)
        remove_unfinished_imports(home.runs)
        prepare_index(home.runs, home.url)  # before anything is computed
        return home.of(spec)

    def of(self, spec: Spec) -> Home:
        """The same home for the runs of another spec."""
        remove_lost_leftovers(self.runs, f"{spec.name}-*")
        return replace(self, text=spec.text)

    def find(self, spec: Spec, seed: int) -> RunFolder | None:
        """The existing run to use, finished or to be resumed; None: a new run is needed."""
        found = None if self.existing == "ignore" else find_run(self.runs, spec.name, spec.hash(), seed)
        return found if found and (self.existing == "resume" or found.state().state == "finished") else None

    def create(self, spec: Spec, seed: int) -> RunFolder:
        """A new run's folder, locked."""
        changed, files = spec.changed(), spec.files()
        folder = RunFolder.create(self.runs, spec.name, seed)
        with folder.removed_on_error():
            folder.describe(spec.dump(), experiment=spec.hash(), text=self.text, changed=changed, files=files)
        return folder


@dataclass(eq=False)
class RunJob(Job):
    """The runs of a spec, one for each seed."""

    spec: Spec
    home: Home
    together: bool = False
    known: Mapping[int, RunFolder] = field(default_factory=dict)
    """Seed -> finished run that counts for it, whatever its name."""
    folders: dict[int, RunFolder] = field(default_factory=dict)
    """Seed -> its started run."""
    summaries: dict[int, RunSummary] = field(default_factory=dict)
    """Seed -> its ended run."""

    @property
    def finished(self) -> bool:
        states = [summary.state for summary in self.summaries.values()]
        return states == ["finished"] * len(self.spec.seeds)

    def problems(self, reason: str | None = None) -> list[str]:
        """One line per run that ended without being finished: this reason, or the run's error."""
        return [
            ": ".join(filter(None, (f"{run.run} is {run.state}", reason or run.error)))
            for run in self.summaries.values()
            if run.state != "finished"
        ]

    def results(self) -> dict[int, Sequence[Evaluation]]:
        """Seed -> its tests so far; seeds in the spec's order."""
        return {seed: self.folders[seed].tests() if seed in self.folders else () for seed in self.spec.seeds}

    @override
    def tasks(self) -> Iterator[FolderTask]:
        """The runs that are not finished."""
        for seed in self.spec.seeds:
            found = self.known.get(seed) or self.home.find(self.spec, seed)
            if found is not None and found.state().state == "finished":
                with suppress(StoreError):  # a killed driver may not have entered it
                    index_run(self.home.url, found)
                self.folders[seed], self.summaries[seed] = found, found.summary()
            else:
                yield RunTask(self, seed, found)


class RunTask(FolderTask):
    """A run that a process executes. Turns what the process writes into the folder into events."""

    job: RunJob

    def __init__(self, job: RunJob, seed: int, found: RunFolder | None) -> None:
        self.job, self._seed, self._found = job, seed, found
        self._failure: tuple[str | None, str | None] = None, None

    @override
    def begin(self) -> Path:
        job = self.job
        folder = self._found = self._folder = self._found or job.home.create(job.spec, self._seed)
        if not folder.path.is_dir():
            raise RunError("the run was removed while it waited", where=folder.id)
        folder.release()
        job.folders[self._seed] = folder
        self._ends = {name: new_lines(folder.path / name, 0)[1] for name in ("events.jsonl", "tests.jsonl")}
        self._progress = read_object(folder.progress) or {}
        self._before = folder.state()
        self._launched: list[RunEvent] = [*self._update_index(), RunLaunched(folder.id)]  # it may wait for long
        return folder.path

    @override
    def events(self) -> Iterator[RunEvent]:
        launched, self._launched = self._launched, []
        yield from launched
        folder = self._folder
        earlier, self._progress = self._progress, read_object(folder.progress) or {}
        happened = self._new_lines("events.jsonl")
        tests = [decode(row) for row in self._new_lines("tests.jsonl")]  # written before these events
        if any(row["event"] in ("started", "resumed") for row in happened):
            yield from self._update_index()
            yield RunStarted(folder.id, self._seed, self.job.spec.training.steps, str(folder.path))
        for name, row in self._progress.items():
            event = from_json(RunAdvanced, row) if name == "RunAdvanced" else from_json(RunBusy, row)
            if event is not None and row != earlier.get(name):
                yield event
        for result in tests:
            if result is not None:
                yield from self._update_index(result)
                yield RunTested(folder.id, result)
        for row in happened:
            if row["event"] == "warning":
                yield RunWarned(folder.id, f"{row['error']} ({row['consequence']})")
            elif row["event"] == "final_test" and (final := folder.final()):
                yield RunFinalTested(folder.id, final)
            elif row["event"] == "failed":
                self._failure = row["error"], row["traceback"]

    def _new_lines(self, name: str) -> list[dict[str, Any]]:
        rows, self._ends[name] = new_lines(self._folder.path / name, self._ends[name])
        return rows

    def _update_index(self, result: Evaluation | None = None) -> Iterator[RunEvent]:
        """Update the run in the database; a failure is a warning."""
        try:
            index_run(self.job.home.url, self._folder)
        except StoreError as error:
            what = "its folder is complete" if result is None else "the test is in the run folder"
            yield RunWarned(self._folder.id, f"{error} (the run continues; {what})")

    @override
    def is_over(self) -> bool:
        """Whether the process ended the run, or did not begin it because the job is halted."""
        state = self._folder.state()
        if state == self._before:
            return self.job.halted is not None
        return self._folder.summary().state not in (*UNFINISHED, "lost")

    @override
    def end(self, problem: str | None) -> Iterator[RunEvent]:
        job, folder, (error, traceback) = self.job, self._folder, self._failure
        system.remove(folder.stop, missing_ok=True)
        summary = folder.summary()
        if problem is not None and summary.state != "finished":
            state = "lost" if summary.state in UNFINISHED else summary.state
            summary, error, traceback = replace(summary, state=state, error=problem), problem, None
        else:
            yield from self._update_index()
        job.summaries[summary.seed] = summary
        yield RunEnded(summary.run, summary.state, error, traceback)
        if summary.error is not None and not job.halted:
            job.error = job.error or summary.error
