"""Experiment: the entry point. One spec, its seeds, one run for each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ..errors import RunError, UsageError
from ..records import RunFolder
from ..records.run_records import RunSummary
from ..spec import Spec
from ..store import Store
from ..training.assembly import check_parts
from .events import Listener, RunEvent
from .jobs import run_side_by_side
from .resuming import find_run, newest_snapshot
from .run import Run
from .signals import StopRequest, stop_on_signals
from .start_from import pinned

Existing = Literal["ignore", "skip", "resume"]


@dataclass(frozen=True)
class Outcome:
    """What became of an experiment's runs, in the order of the seeds; runs never begun are missing."""

    runs: tuple[RunSummary, ...]
    asked: int
    """How many runs were asked for."""
    stop_code: int = 0
    """Exit code of whoever asked to stop (`StopRequest.exit_code`); 0: nobody did."""

    @property
    def exit_code(self) -> int:
        """0 fine, 1 a run failed, 128 + signal or 124 (time limit) when stopped."""
        if all(run.state == "finished" for run in self.runs):
            return 0 if len(self.runs) == self.asked else self.stop_code
        return self.stop_code or 1

    def check(self) -> None:
        """Raise a RunError that names the runs that failed, if any did."""
        failed = [run for run in self.runs if run.state == "failed"]
        if failed:
            raise RunError(
                f"{len(failed)} of {len(self.runs)} runs failed: "
                + "; ".join(f"{run.run}: {run.error}" for run in failed)
            )


class Experiment:
    """Trains and tests an agent on an environment, once for each seed of the spec.

    Args:
        spec: a Spec, or a dictionary of the same shape as a spec file, e.g.
            `{"robot": "panda", "task": "reach", "agent": "sac"}`; what is left out has its default.

    Raises:
        SpecError: the dictionary is no valid spec; carries every problem found.
    """

    def __init__(self, spec: Spec | Mapping[str, Any]) -> None:
        self.spec = spec if isinstance(spec, Spec) else Spec.from_dict(dict(spec))

    def run(
        self,
        runs: str | Path = "runs",
        *,
        database: str | None = None,
        jobs: int = 1,
        existing: Existing = "ignore",
        time_limit: float | None = None,
        listener: Listener | None = None,
        text: str | None = None,
        check: bool = True,
    ) -> Outcome:
        """Run every seed and index the results.

        A run that fails is recorded and does not keep the other seeds from running. SIGINT, SIGTERM, SIGUSR1 and the
        time limit end the current round, write a checkpoint and leave the run `stopped`.

        Args:
            runs: folder that holds the run folders and, unless `database` says otherwise, karolos.sqlite.
            database: SQLAlchemy URL of the results database.
            jobs: seeds that run at the same time, each in a process of its own.
            existing: what to do with runs of this experiment that are there already. "skip": seeds that are finished
                are not run again. "resume": nor those, and runs that ended too soon go on from their newest checkpoint,
                bit for bit in lockstep.
            time_limit: seconds after which to stop.
            listener: is called with every RunEvent.
            text: the spec as its author wrote it, kept beside the resolved one.
            check: raise when a run failed, once all have ended.

        Raises:
            RunError: a run failed, and `check` is on.
            UsageError: the spec's parts do not go together.
            MachineError: the runs folder cannot be written.
            StoreError: the database cannot be used.
        """
        if jobs < 1:
            raise UsageError(f"jobs is {jobs}", hint="run at least one seed at a time")
        folder = Path(runs)
        url = database or Store.default_url(folder)
        check_parts(self.spec)
        RunFolder.check_writable(folder)
        Store(url).close()  # a database that cannot be used is told before anything is computed
        tell = listener or _ignore
        spec = pinned(self.spec.alone(), folder)
        work = SeedRunner(spec.dump(), folder, url, text, existing)
        with stop_on_signals(time_limit=time_limit) as stop:
            if jobs == 1 or len(self.spec.seeds) == 1:
                found = []
                for seed in self.spec.seeds:
                    if not stop.asked:
                        found.append(work(seed, tell, stop))
            else:
                found = run_side_by_side(work, self.spec.seeds, jobs, tell, stop)
        order = {seed: place for place, seed in enumerate(self.spec.seeds)}
        outcome = Outcome(tuple(sorted(found, key=lambda run: order[run.seed])), len(order), stop.exit_code)
        if check:
            outcome.check()
        return outcome


def resume_run(
    folder: RunFolder, url: str, *, time_limit: float | None = None, listener: Listener | None = None
) -> Outcome:
    """Go on with one run from its newest checkpoint. A finished one stays.

    In lockstep it is bit for bit as if it had not ended.

    Args:
        folder: the run's.
        url: SQLAlchemy URL of the results database.
        time_limit: seconds after which to stop.
        listener: is called with every RunEvent.

    Raises:
        RunError: another process is running it, or no checkpoint can be used.
        SpecError: its resolved spec is damaged, or of another version.
    """
    tell = listener or _ignore
    if folder.state().state == "finished":
        return Outcome((folder.summary(),), 1)
    spec = Spec.from_dict(folder.spec())
    check_parts(spec)
    with stop_on_signals(time_limit=time_limit) as stop, Store(url) as store, folder:
        summary = _go_on(folder, spec, store, tell, stop)
    return Outcome((summary,), 1, stop.exit_code)


@dataclass(frozen=True)
class SeedRunner:
    """Runs one seed of a resolved spec from an empty folder to its end; a failure stands in the summary's state.

    Picklable, so that a new process can be handed it.
    """

    resolved: dict[str, Any]
    runs: Path
    url: str
    text: str | None
    existing: Existing = "ignore"

    def __call__(self, seed: int, tell: Listener, stop: StopRequest) -> RunSummary:
        spec = Spec.from_dict(self.resolved)
        if self.existing != "ignore":
            found = find_run(self.runs, spec.name, spec.hash(), seed)
            if found is not None and found.state().state == "finished":
                return found.summary()
            if found is not None and self.existing == "resume":
                with Store(self.url) as store, found:
                    return _go_on(found, spec, store, tell, stop)
        with Store(self.url) as store, RunFolder.create(self.runs, spec.name, seed) as folder:
            folder.describe(spec.dump(), experiment=spec.hash(), text=self.text)
            store.add_run(folder.summary(), spec.dump(), folder.versions())
            return Run(spec, seed, folder, store, tell, stop).execute()


def _go_on(folder: RunFolder, spec: Spec, store: Store, tell: Listener, stop: StopRequest) -> RunSummary:
    folder.lock()
    snapshot = newest_snapshot(folder)
    folder.next_attempt()
    store.add_run(folder.summary(), spec.dump(), folder.versions())
    return Run(spec, folder.description()["seed"], folder, store, tell, stop, snapshot).execute()


def _ignore(event: RunEvent) -> None:
    pass
