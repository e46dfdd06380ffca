"""Search: a spec's sweep from its first trial to the best settings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

from ..errors import SpecError, UsageError
from ..experiment.experiment import SeedRunner
from ..experiment.signals import StopRequest, stop_on_signals
from ..experiment.start_from import pinned
from ..records import RunFolder
from ..records.sweep_records import FOLDER, SweepFinal, Trial
from ..spec import Spec, Sweep, spec_of_trial
from ..spec.sweep import DEFAULT_TRIALS
from ..store import Store
from ..training.assembly import check_parts
from . import choosing
from .crew import Crew
from .folder import SweepFolder
from .records import Outcome, SweepEvent, SweepListener
from .study import Study
from .trials import Book, Trials

LONGEST_NAME = 58
"""Of a sweep, so that its trials' runs can be called <name>-t0000."""


class Search:
    """Carries a spec's sweep out: each trial is the spec with other values, run on the sweep's seeds.

    Args:
        spec: a Spec with a sweep, or a dictionary of the same shape as a spec file.
        text: the spec as its author wrote it, kept in every run's folder.
        trials: how many the sweep is to have, instead of what the spec says.

    Raises:
        SpecError: the dictionary is no valid spec; carries every problem found.
        UsageError: there is no sweep in it, or its name is too long.
    """

    def __init__(self, spec: Spec | Mapping[str, Any], *, text: str | None = None, trials: int | None = None) -> None:
        found = spec if isinstance(spec, Spec) else Spec.from_dict(dict(spec))
        sweep = _sweep_of(found)
        self.sweep = sweep if trials is None else sweep.model_copy(update={"trials": trials})
        self.spec = found.model_copy(update={"sweep": self.sweep})
        self._text = text

    @property
    def asked(self) -> int:
        """How many trials the sweep is to have."""
        most = self.sweep.trials or DEFAULT_TRIALS
        if self.sweep.sampler != "grid":
            return most
        size = sum(1 for _ in self.sweep.combinations())
        return min(self.sweep.trials or size, size)

    def folder(self, runs: str | Path) -> Path:
        """The sweep's own folder in a runs folder."""
        return Path(runs) / FOLDER / self.spec.name

    def run(
        self,
        runs: str | Path = "runs",
        *,
        database: str | None = None,
        jobs: int = 1,
        time_limit: float | None = None,
        listener: SweepListener | None = None,
    ) -> Outcome:
        """Carry out the trials that are missing, choose the best, and write down what was found.

        The same call after an interruption goes on: trials that had begun are finished, their runs from their newest
        checkpoints, and none is run twice. A trial fails when one of its runs does, or when its parts do not go
        together; it counts as one of the trials.

        Args:
            runs: folder of the run folders; the sweep's own is `sweeps/<name>` in it.
            database: SQLAlchemy URL of the results database.
            jobs: trials at the same time; each seed of each is a process.
            time_limit: seconds after which to stop.
            listener: is called with every SweepEvent.

        Raises:
            UsageError: the spec's parts do not go together, or a sweep of this name searches something else.
            RunError: another process carries this sweep out.
            MachineError: the runs folder cannot be written, or processes cannot be started.
            StoreError: the database cannot be used.
        """
        if jobs < 1:
            raise UsageError(f"jobs is {jobs}", hint="run at least one trial at a time")
        root = Path(runs)
        url = database or Store.default_url(root)
        check_parts(self.spec)
        RunFolder.check_writable(root)
        runner = SeedRunner({}, root, url, self._text, "resume")
        tell = listener or _ignore
        base = pinned(self.spec, root)
        size = jobs * len(self.sweep.seeds)
        folder = SweepFolder(self.folder(root), self.spec, self.asked)
        with (
            Store(url) as store,
            folder,
            stop_on_signals(time_limit=time_limit) as stop,
            Crew(size, folder.workers, runner) as crew,
        ):
            study = Study(folder.journal, self.sweep, self.spec.name, self.spec.training.steps)
            book = Book(folder, study, store, tell)
            book.write()
            crew.run(Trials(base, self.sweep, study, jobs, self.asked, tell, stop, book), stop)
            final = None
            if self.sweep.final is not None and not stop.requested and study.ranked():
                final = choosing.choose(base, self.sweep.final, study, crew, tell, stop)
            return self._conclude(book, final, stop)

    def _conclude(self, book: Book, final: SweepFinal | None, stop: StopRequest) -> Outcome:
        from ..report.search import write_search_figures  # noqa: PLC0415  (matplotlib takes half a second)

        folder, study = book.folder, book.study
        ranked = study.ranked()
        best = study.trial(final.chosen) if final is not None else ranked[0] if ranked else None
        if best is not None:
            seeds = self.spec.seeds if final is None else final.report_seeds
            spec = spec_of_trial(self.spec, best.drawn, f"{self.spec.name}-best", seeds, best.name)
            folder.write_best(spec, _comment(self.sweep, best, final))
            write_search_figures(
                study.trials(), self.sweep.objectives[0], self.sweep.space, study.importances(), folder.figures
            )
        folder.write_final(final)
        book.write()
        return Outcome(
            sweep=self.sweep,
            trials=study.trials(),
            asked=self.asked,
            best=best,
            front=study.front(),
            final=final,
            folder=folder.path,
            stop_code=stop.exit_code,
        )


def samples(spec: Spec, count: int) -> Iterator[tuple[dict[str, Any], Spec | SpecError]]:
    """What trials may draw, each with its spec or why that is none: at random, or a grid's first combinations."""
    sweep = _sweep_of(spec)
    drawn = list(islice(sweep.combinations(), count)) if sweep.sampler == "grid" else Study.draws(sweep, count)
    for place, values in enumerate(drawn):
        name = f"{spec.name}-t{place:03}"
        try:
            yield values, spec_of_trial(spec, values, name, sweep.seeds, name)
        except SpecError as error:
            yield values, error


def _sweep_of(spec: Spec) -> Sweep:
    """The spec's sweep. Raises UsageError where there is none, or the name leaves no room for its trials'."""
    if spec.sweep is None:
        raise UsageError(
            f"the spec {spec.name!r} has no sweep",
            hint="add e.g. sweep: {space: {agent.learning_rate: {float: [1e-5, 1e-2], log: true}}}",
        )
    if len(spec.name) > LONGEST_NAME:
        raise UsageError(
            f"the name {spec.name!r} is longer than {LONGEST_NAME} characters, which leaves no room for its trials'",
            where="name",
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


def _ignore(event: SweepEvent) -> None:
    pass
