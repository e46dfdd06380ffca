"""How sweeps and their trials are told: lines while they go on, rows, and how far to trust the best."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from karolos.report.terminal import clean

from .common import rows

if TYPE_CHECKING:
    from karolos.records.sweep_records import SweepFinal, Trial
    from karolos.sweep.records import Outcome, SweepEvent


class Teller:
    """One line per trial, on stderr."""

    def __init__(self, objectives: tuple[str, ...], *, quiet: bool) -> None:
        self._objectives = objectives
        self._quiet = quiet

    def __call__(self, event: SweepEvent) -> None:
        from karolos.experiment.events import RunWarned
        from karolos.sweep.records import TrialBegan, TrialEnded

        if isinstance(event, RunWarned):
            self._say(f"{event.run}: {event.warning}")
        elif isinstance(event, TrialEnded) and event.trial.state == "failed":
            self._say(f"trial {event.trial.number} failed: {event.trial.error} [{event.done}/{event.asked}]")
        elif self._quiet:
            return
        elif isinstance(event, TrialBegan):
            self._say(f"trial {event.trial.number}: {drawn_text(event.trial)}")
        elif isinstance(event, TrialEnded):
            found = self._values(event.trial.values) if event.trial.values else ""
            self._say(f"trial {event.trial.number} {event.trial.state}{found} [{event.done}/{event.asked}]")
        else:
            who = ", ".join(map(str, event.trials))
            self._say(f"trials {who} on seeds {', '.join(map(str, event.seeds))}, to {event.purpose}")

    def _values(self, values: tuple[float, ...]) -> str:
        return ": " + ", ".join(f"{name} {value:.4g}" for name, value in zip(self._objectives, values, strict=True))

    @staticmethod
    def _say(text: str) -> None:
        print(clean(text), file=sys.stderr, flush=True)


def drawn_text(trial: Trial) -> str:
    """What a trial drew, in one line."""
    return ", ".join(
        f"{key}={value:.4g}" if isinstance(value, float) else f"{key}={value}" for key, value in trial.drawn.items()
    )


def report(outcome: Outcome, *, quiet: bool, json: bool) -> None:
    """The trials to stdout; what was chosen, and how far to trust it, to stderr."""
    if json or not quiet:
        rows(
            [trial_row(trial, outcome.objectives, outcome.sweep.space, outcome.final) for trial in outcome.trials],
            json=json,
        )
    if quiet:
        return
    for trial in outcome.front if len(outcome.objectives) > 1 else ():
        print(clean(f"no trial beats trial {trial.number} in every objective: {drawn_text(trial)}"), file=sys.stderr)
    if outcome.best is None:
        print("no trial is complete yet", file=sys.stderr)
        return
    print(clean(f"best: trial {outcome.best.number}, {drawn_text(outcome.best)}"), file=sys.stderr)
    if outcome.final is not None:
        tell_final(outcome.final, outcome.objectives)
    where_next(outcome.folder)


def trial_row(
    trial: Trial, objectives: Sequence[str], parameters: Iterable[str], final: SweepFinal | None
) -> dict[str, Any]:
    """A trial as a row: objectives, the same on fresh and on unused seeds where it came so far, settings, runs."""
    row: dict[str, Any] = {"trial": trial.number, "state": trial.state}
    for place, name in enumerate(objectives):
        row[name] = trial.values[place] if trial.values else None
        if final is not None:
            fresh = final.fresh.get(trial.number)
            row[f"{name}_fresh"] = fresh[place] if fresh else None
            unused = final.reported if trial.number == final.chosen else None
            row[f"{name}_unused"] = unused[place] if unused else None
    settings = {key: trial.drawn.get(key) for key in parameters}  # None for those that it did not draw
    return {**row, **settings, "error": trial.error, "runs": list(trial.runs)}


def tell_final(final: SweepFinal, objectives: Sequence[str]) -> None:
    """How good the chosen trial is, on the seeds that it was tuned on, chosen by and reported on; to stderr."""
    for place, name in enumerate(objectives):
        line = (
            f"{name}: {final.tuned[place]:.4g} on the seeds it was tuned on, "
            f"{final.fresh[final.chosen][place]:.4g} on {len(final.seeds)} fresh ones that it was chosen by"
        )
        if final.reported is not None:
            gap = final.tuned[place] - final.reported[place]
            line += f", {final.reported[place]:.4g} on {len(final.report_seeds)} used for nothing else: gap {gap:+.4g}"
        print(line, file=sys.stderr)


def where_next(folder: Path) -> None:
    """What to do with the best trial; to stderr."""
    print(clean(f"`karolos run {folder / 'best.yaml'}` runs it; figures in {folder}"), file=sys.stderr)
