"""Search: runs the sweep of a spec."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

from ..errors import KarolosError, UsageError
from ..experiment.events import RunEvent, RunWarned
from ..experiment.signals import StopRequest
from ..experiment.start_from import pinned
from ..launchers.driver import driving
from ..launchers.runs import Home
from ..records.sweep_records import FOLDER, SweepFinal, Trial, best_name
from ..specification import Spec, Sweep, spec_from_dict, spec_of_trial
from ..specification.sweep import DEFAULT_TRIALS
from ..store import Store
from ..training.assembly import check_parts
from . import choosing
from .events import SweepListener, SweepOutcome
from .folder import SweepFolder
from .study import Study
from .trials import Trials

LONGEST_NAME = 58
"""Longest name of a sweep, because its trials' runs are named <name>-t0000."""


class Search:
    """Runs a spec's sweep: each trial is the spec with other values, run on the sweep's seeds.

    Args:
        spec: a Spec with a sweep, or a dictionary of the same shape as a spec file.
        trials: number of trials; None: the spec's.

    Raises:
        SpecError: the dictionary is not a valid spec; carries every problem found.
        UsageError: the spec has no sweep, or its name is too long.
    """

    def __init__(self, spec: Spec | Mapping[str, Any], *, trials: int | None = None) -> None:
        base = spec if isinstance(spec, Spec) else spec_from_dict(dict(spec))
        sweep = _sweep_of(base)
        self.sweep = sweep if trials is None else sweep.model_copy(update={"trials": trials})
        self.spec = base.model_copy(update={"sweep": self.sweep})

    @property
    def asked(self) -> int:
        """Number of trials that the sweep should have."""
        most = self.sweep.trials or DEFAULT_TRIALS
        if self.sweep.sampler != "grid":
            return most
        size = sum(1 for _ in self.sweep.combinations())
        return min(self.sweep.trials or size, size)

    def folder(self, runs: str | Path) -> Path:
        """The sweep's folder in a runs folder."""
        return Path(runs) / FOLDER / self.spec.name

    def run(
        self,
        runs: str | Path = "runs",
        *,
        database: str | None = None,
        jobs: int = 1,
        time_limit: float | None = None,
        listener: SweepListener = lambda _: None,
    ) -> SweepOutcome:
        """Run the missing trials, choose the best one, and write the results.

        The same call resumes an interrupted sweep: it continues unfinished runs from their newest checkpoints and runs
        no trial twice. A trial fails if one of its runs fails or its parts are incompatible. Failed trials count.

        Args:
            runs: folder of the run folders; the sweep's folder is `sweeps/<name>` in it.
            database: SQLAlchemy URL of the results database.
            jobs: number of concurrent trials; each seed of a trial has its own process.
            time_limit: seconds after which to stop.
            listener: called with every SweepEvent.

        Raises:
            UsageError: the spec's parts are incompatible, or a sweep of this name has other settings.
            RunError: another process runs this sweep.
            MachineError: the runs folder cannot be written, or processes cannot be started.
            StoreError: the database cannot be used.
        """
        note = check_parts(self.spec)
        if note is not None:
            listener(RunWarned(self.spec.name, note))
        home = Home.prepared(self.spec, runs, database, "resume")
        base = pinned(self.spec.model_copy(update={"launcher": None}), home.runs)
        folder = SweepFolder(self.folder(runs), self.spec, self.asked)

        def warn(event: RunEvent) -> None:
            if isinstance(event, RunWarned):
                listener(event)

        with (
            Store(home.url) as store,
            folder.claimed(listener),
            driving(self.spec, jobs * len(self.sweep.seeds), warn, time_limit) as driver,
        ):
            before = folder.write()
            driver.run(Trials(base, home, self.sweep, jobs, driver.stop, folder))
            found = folder.write()
            final, left = before.final if found.ended == before.ended else None, False
            if self.sweep.final is not None and found.ranked:
                chosen = None if driver.stop.requested else choosing.choose(base, home, found, driver, listener, store)
                left = chosen is None and driver.stop.requested
                final = final if left else chosen
            return self._conclude(folder, final, driver.stop, left)

    def _conclude(self, folder: SweepFolder, final: SweepFinal | None, stop: StopRequest, left: bool) -> SweepOutcome:
        from ..report.figures import look, write_plots  # noqa: PLC0415

        folder.write_final(final)
        record = folder.write()
        if (best := record.best) is not None:
            unused = tuple(islice(choosing.unused_seeds(self.spec), len(self.spec.seeds)))
            seeds = unused if final is None else final.report_seeds
            spec = spec_of_trial(self.spec, best.drawn, best_name(self.spec.name), seeds, best.name)
            folder.write_best(choosing.for_report(spec), _comment(self.sweep, best, final))
        if best is not None and not stop.requested:  # the figures take seconds, and a resumed sweep draws them
            with look():
                write_plots(folder.study.figures(), folder.figures)
        return SweepOutcome(**vars(record), front=folder.study.front(), stop_code=stop.exit_code, left=left)


def samples(spec: Spec, count: int) -> Iterator[tuple[dict[str, Any], Spec | KarolosError]]:
    """The values of the first trials with their specs, or the error of one that cannot run."""
    sweep = _sweep_of(spec)
    drawn = list(islice(sweep.combinations(), count)) if sweep.sampler == "grid" else Study.draws(sweep, count)
    for place, values in enumerate(drawn):
        name = f"{spec.name}-t{place:03}"
        try:
            trial = choosing.for_search(spec_of_trial(spec, values, name, sweep.seeds, name))
            check_parts(trial)
        except KarolosError as error:
            yield values, error
        else:
            yield values, trial


def _sweep_of(spec: Spec) -> Sweep:
    """The spec's sweep. Raises UsageError if it has none or its name is too long."""
    if spec.sweep is None:
        raise UsageError(
            f"the spec {spec.name!r} has no sweep",
            hint="add e.g. sweep: {space: {agent.learning_rate: {float: [1e-5, 1e-2], log: true}}}",
        )
    if len(spec.name) > LONGEST_NAME:
        raise UsageError(
            f"the name {spec.name!r} is longer than {LONGEST_NAME} characters; trials append to it",
            setting="name",
            hint="give a shorter one (name=...)",
        )
    return spec.sweep


def _comment(sweep: Sweep, best: Trial, final: SweepFinal | None) -> Iterator[str]:
    """The lines above the best trial's spec."""
    drawn = ", ".join(f"{key} = {value}" for key, value in best.drawn.items())
    yield f"Trial {best.number} of a sweep: {drawn}."
    for place, name in enumerate(sweep.objectives):
        if best.values is not None:
            yield f"{name} {best.values[place]:.4g} on the seeds it was tuned on ({_listed(sweep.seeds)})"
        if final is not None:
            yield f"{name} {final.fresh[best.number][place]:.4g} on the seeds it was chosen by ({_listed(final.seeds)})"
        if final is not None and final.reported is not None:
            yield f"{name} {final.reported[place]:.4g} on seeds used for nothing else ({_listed(final.report_seeds)})"


def _listed(seeds: tuple[int, ...]) -> str:
    return ", ".join(map(str, seeds))
