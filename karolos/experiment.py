"""Experiment: the entry point. One spec, its seeds, one run for each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .assembly import check_parts
from .errors import RunError, UsageError
from .events import Listener, RunEvent
from .jobs import run_side_by_side
from .run import Run
from .run_folder import RunFolder
from .run_records import RunSummary
from .signals import StopRequest, stop_on_signals
from .spec import Spec
from .store import Store


@dataclass(frozen=True)
class Outcome:
    """What became of an experiment's runs, in the order of the seeds; runs never begun are missing."""

    runs: tuple[RunSummary, ...]
    stopped_by: int | None = None
    """The signal that asked to stop, if one did."""

    @property
    def exit_code(self) -> int:
        """0 fine, 1 a run failed, 128 + signal when stopped."""
        if self.stopped_by:
            return 128 + self.stopped_by
        return int(any(run.state != "finished" for run in self.runs))

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
        listener: Listener | None = None,
        text: str | None = None,
        check: bool = True,
    ) -> Outcome:
        """Run every seed and index the results.

        A run that fails is recorded and does not keep the other seeds from running. SIGINT and SIGTERM end the
        current round, write a checkpoint and leave the run `stopped`.

        Args:
            runs: folder that holds the run folders and, unless `database` says otherwise, karolos.sqlite.
            database: SQLAlchemy URL of the results database.
            jobs: seeds that run at the same time, each in a process of its own.
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
        work = SeedRunner(self.spec.dump(), folder, url, text)
        with stop_on_signals() as stop:
            if jobs == 1 or len(self.spec.seeds) == 1:
                found = []
                for seed in self.spec.seeds:
                    if stop.signal is None:
                        found.append(work(seed, tell, stop))
            else:
                found = run_side_by_side(work, self.spec.seeds, jobs, tell, stop)
        order = {seed: place for place, seed in enumerate(self.spec.seeds)}
        outcome = Outcome(tuple(sorted(found, key=lambda run: order[run.seed])), stop.signal)
        if check:
            outcome.check()
        return outcome


@dataclass(frozen=True)
class SeedRunner:
    """Runs one seed of a resolved spec from an empty folder to its end; a failure stands in the summary's state.

    Picklable, so that a new process can be handed it.
    """

    resolved: dict[str, Any]
    runs: Path
    url: str
    text: str | None

    def __call__(self, seed: int, tell: Listener, stop: StopRequest) -> RunSummary:
        spec = Spec.from_dict(self.resolved)
        with Store(self.url) as store, RunFolder.create(self.runs, spec.name, seed) as folder:
            folder.describe(spec.dump(), experiment=spec.hash(), text=self.text)
            store.add_run(folder.summary(), spec.dump())
            return Run(spec, seed, folder, store, tell, stop).execute()


def _ignore(event: RunEvent) -> None:
    pass
