"""Experiment, the entry point from Python: one spec, one run per seed."""

from __future__ import annotations

import signal
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..errors import RunError, StoreError, UsageError
from ..experiment.check import check_parts
from ..experiment.continuing import continue_from, continued_spec
from ..experiment.events import Listener, RunEnded, RunWarned, print_progress
from ..experiment.run import run_or_resume
from ..experiment.signals import StopRequest, StopRequestedError, stop_on_signals
from ..experiment.start_from import pinned
from ..experiment.tracking import Tracking
from ..experiment.writer import index_run
from ..records import RunFolder
from ..records.run_records import RunSummary
from ..specification import Spec, load_spec, spec_from_dict
from ..store.query import prepare_index
from ..system import cores
from ..system.files import FileLock
from .driver import Driver, make_launcher
from .runs import Existing, Home, RunJob


@dataclass(frozen=True)
class Outcome:
    """How an experiment, a sweep, a suite or a matrix of transfers ended."""

    complete: bool
    """Whether every requested run is finished."""
    stop_code: int = 0
    """`StopRequest.exit_code`; 0 if no stop was requested."""
    runs: tuple[RunSummary, ...] = ()
    """The runs of an experiment, in the order of the seeds. Seeds that never started after a stop are missing; a run
    whose process died is `lost`."""

    @classmethod
    def of(cls, runs: Sequence[RunSummary], requested: int, stop_code: int = 0) -> Outcome:
        """The outcome of an experiment with this number of seeds."""
        return cls(sum(run.state == "finished" for run in runs) == requested, stop_code, tuple(runs))

    @property
    def exit_code(self) -> int:
        """0 if it is complete, else 1; after a stop 128 + signal, or 124 for the time limit."""
        return 0 if self.complete else self.stop_code or 1

    def __str__(self) -> str:
        """A table with one line per run."""
        rows = [("run", "state", "steps", "return", "success end", "seconds")]
        for run in self.runs:
            mean, end = ("-" if value is None else f"{value:,.2f}" for value in (run.mean_return, run.success_end))
            rows.append((run.run, run.state, f"{run.steps:,}", mean, end, f"{run.seconds:.1f}"))
        widths = [max(map(len, cells)) for cells in zip(*rows, strict=True)]
        return "\n".join(
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
        )

    def check(self) -> None:
        """Raise a RunError that names the failed and lost runs, if there are any."""
        failed = [run for run in self.runs if run.state in ("failed", "lost")]
        if failed:
            raise RunError(
                f"{len(failed)} of {len(self.runs)} runs failed: "
                + "; ".join(f"{run.run}: {run.error}" for run in failed)
            )


class Experiment:
    """Trains and tests an agent in an environment, once for each seed of the spec.

    Args:
        spec: a Spec, a spec file or the name of a shipped spec, or a dictionary of the same shape as a spec file, e.g.
            `{"robot": "panda", "task": "reach", "agent": "sac"}`; missing keys have their defaults.

    Raises:
        SpecError: the file or dictionary is not a valid spec; lists every problem.
    """

    def __init__(self, spec: Spec | str | Path | Mapping[str, Any]) -> None:
        self.spec = spec if isinstance(spec, Spec) else load_spec(spec)

    def run(
        self,
        runs: str | Path = "runs",
        *,
        database: str | None = None,
        jobs: int | None = None,
        existing: Existing = "ignore",
        time_limit: float | None = None,
        listener: Listener | None = None,
        progress: bool = False,
        check: bool = True,
    ) -> Outcome:
        """Run every seed and index the results.

        The failure of a run is written down, and the other seeds run. SIGINT, SIGTERM, SIGHUP, SIGUSR1 and the time
        limit stop the run after the current round, also during a test, with a checkpoint and the state `stopped`.

        Args:
            runs: folder of the run folders and, without `database`, of karolos.sqlite.
            database: SQLAlchemy URL of the results database.
            jobs: seeds that run at the same time, each in its own process; None: one, or with another launcher than
                `local` as many as it has room for.
            existing: what to do with existing runs of this experiment. "ignore": run every seed again. "skip": do not
                run finished seeds again. "resume": as "skip", and unfinished runs resume from their newest checkpoint,
                bit for bit in lockstep.
            time_limit: seconds after which to stop.
            listener: is called with every RunEvent.
            progress: without `listener`: whether to print a line on stderr for each start, test, warning and end.
            check: whether to raise an error once all runs have ended, if one failed or a signal stopped them.

        Raises:
            KeyboardInterrupt, SystemExit: Ctrl-C or another signal stopped the runs, which have their checkpoints, and
                `check` is on: a script does not go on with the next experiment.
            RunError: a run failed, and `check` is on. Or another process runs seeds of this experiment, and `existing`
                is not "ignore".
            UsageError: the spec's parts do not fit together, or an argument has no such value.
            MachineError: the runs folder cannot be written.
            StoreError: the database cannot be used.
        """
        if time_limit is not None and not (isinstance(time_limit, int | float) and time_limit > 0):
            raise UsageError(f"time_limit is {time_limit!r}, and must be a positive number of seconds")
        is_local = self.spec.launcher is None or self.spec.launcher.name == "local"
        jobs = min(1 if jobs is None else jobs, len(self.spec.seeds)) if is_local else jobs
        home = Home.prepared(self.spec, runs, database, existing)
        listener = listener or (print_progress if progress else lambda _: None)
        summaries: list[RunSummary] = []
        with stop_on_signals(time_limit=time_limit) as stop, suppress(StopRequestedError), ExitStack() as stack:
            with stop.at_once():  # within the time limit, because an environment may hang
                check_parts(self.spec, jobs or 1)
            spec = pinned(self.spec.alone(), home.runs)
            for seed in spec.seeds:
                claim(home, spec, seed, stack)
            if is_local and jobs == 1:
                folders = (home.find(spec, one) or home.create(spec, one) for one in spec.seeds if not stop.requested)
                summaries = [_execute_one_of(one, home.url, listener, stop) for one in folders]
            else:
                job = RunJob(spec, home)
                with make_launcher(self.spec, jobs) as launcher:
                    Driver(launcher, listener, stop).run([job])
                summaries = [job.summaries[seed] for seed in spec.seeds if seed in job.summaries]
        outcome = Outcome.of(summaries, len(self.spec.seeds), stop.exit_code)
        if check:
            if stop.signal == signal.SIGINT:
                raise KeyboardInterrupt
            if stop.signal is not None:
                sys.exit(stop.exit_code)
            outcome.check()
        return outcome


def resume_run(
    folder: RunFolder,
    url: str,
    overrides: Sequence[str] = (),
    *,
    time_limit: float | None = None,
    listener: Listener | None = None,
) -> Outcome:
    """Resume one run from its newest checkpoint, bit for bit in lockstep. A finished run is returned as it is.

    With overrides a finished run is continued by a new run: see `continued_spec`. `time_limit` is in s from now.

    Raises:
        RunError: another process is running it, or no checkpoint can be used.
        SpecError: its resolved spec is damaged, or of another version.
    """
    if not overrides and folder.state().state == "finished":
        return Outcome.of([folder.summary()], 1)
    spec = continued_spec(folder, overrides) if overrides else spec_from_dict(folder.spec())
    prepare_index(folder.path.parent, url)  # an unusable database is an error before anything is computed
    listener = listener or (lambda _: None)
    with stop_on_signals(time_limit=time_limit) as stop:
        with suppress(StopRequestedError), stop.at_once():
            check_parts(spec)
        if stop.requested:
            return Outcome.of([] if overrides else [folder.summary()], 1, stop.exit_code)
        if overrides:
            folder = continue_from(folder, spec, listener)
        summary = _execute(folder, url, listener, stop)
    return Outcome.of([summary], 1, stop.exit_code)


def claim(home: Home, spec: Spec, seed: int, stack: ExitStack) -> None:
    """Claim this seed, so that no other process runs a second copy of its run. The stack releases the claim.

    Raises:
        RunError: another process has claimed the seed, and its run is not finished.
    """
    lock = FileLock(home.runs / f".{spec.name}-{spec.hash()[:12]}-s{seed}.lock")
    if lock.acquire():
        stack.callback(lock.remove)
        return
    found = home.find(spec, seed)
    if home.existing != "ignore" and (found is None or found.state().state != "finished"):
        raise RunError(
            f"another process runs seed {seed}, or will run it",
            where=spec.name,
            hint="`karolos runs list --watch` shows its runs; wait for it, or stop it first",
        )


def _execute_one_of(folder: RunFolder, url: str, listener: Listener, stop: StopRequest) -> RunSummary:
    """As `_execute`. If one run cannot begin or resume, the other seeds are still run."""
    try:
        return _execute(folder, url, listener, stop)
    except RunError as error:
        if folder.is_locked():  # another process runs it
            raise
        listener(RunEnded(folder.id, "failed", str(error)))
        return replace(folder.summary(), state="failed", error=str(error))


def _execute(folder: RunFolder, url: str, listener: Listener, stop: StopRequest) -> RunSummary:
    """Execute or resume a run in this process. A finished run is only entered into the index."""
    with folder:
        if folder.state().state == "finished":
            try:
                index_run(url, folder)  # it may have ended elsewhere
            except StoreError as error:
                listener(RunWarned(folder.id, f"{error} (its folder is complete)"))
        else:
            folder.lock()
            stop.watch(folder.stop)
            run_or_resume(folder, url, Tracking(listener), stop, two_processes=cores() >= 2)
            stop.watch(folder.stop)  # another seed may follow
        return folder.summary()
