"""`karolos sweep`: search for good settings."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from karolos.errors import MachineError, SpecError, UsageError
from karolos.terminal import clean

from .common import Database, Json, Runs, rows
from .run import TimeLimit, seconds

if TYPE_CHECKING:
    from karolos.sweep.records import Final, Outcome, SweepEvent, Trial
    from karolos.sweep.search import Search

SAMPLES = 5
"""Sampled specs that --dry-run prints at most."""
DASHBOARD = "optuna-dashboard"


def sweep(
    spec: Annotated[Path, typer.Argument(metavar="SPEC", help="A YAML spec with a sweep.", show_default=False)],
    overrides: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[PATH=VALUE]...",
            help="Settings that replace the spec's, e.g. training.steps=5000 sweep.sampler=random.",
            show_default=False,
        ),
    ] = None,
    runs: Runs = Path("runs"),
    database: Database = None,
    trials: Annotated[
        int | None, typer.Option(min=1, help="Trials in all, instead of the spec's.", show_default=False)
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Trials at the same time; each seed of each is a process.")] = 1,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check the search and print some sampled specs.")] = False,
    time_limit: TimeLimit = None,
    dashboard: Annotated[
        bool, typer.Option("--dashboard", help=f"Look at the sweep so far with {DASHBOARD} instead.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Show warnings and failures only.")] = False,
    json: Json = False,
) -> None:
    """Search the settings that SPEC's sweep names, trial by trial, and keep the best as a spec.

    Each trial is the spec with other values, run on the sweep's seeds as ordinary runs. The same command goes on with
    a sweep that was interrupted. The sweep's own folder is sweeps/NAME below the runs folder, with best.yaml in it.
    """
    from karolos.spec import load_spec

    found = load_spec(spec, overrides or ())
    from karolos.sweep.search import Search

    search = Search(found, text=spec.read_text("utf-8"), trials=trials)
    if dashboard:
        raise typer.Exit(_open_dashboard(search.folder(runs) / "journal.log"))
    if dry_run:
        _sample(search, json=json)
        return
    teller = _Teller(search.sweep.objectives, quiet=quiet)
    outcome = search.run(runs, database=database, jobs=jobs, time_limit=seconds(time_limit), listener=teller)
    _report(outcome, quiet=quiet, json=json)
    raise typer.Exit(outcome.exit_code)


def _open_dashboard(journal: Path) -> int:
    program = shutil.which(DASHBOARD) or shutil.which(DASHBOARD, path=str(Path(sys.executable).parent))
    if program is None:
        raise MachineError(f"{DASHBOARD} is not installed", hint=f"`pip install {DASHBOARD}`, then try again")
    if not journal.is_file():
        raise UsageError(f"there is no sweep at {journal.parent} yet", hint="`karolos sweep SPEC` begins one")
    process = subprocess.Popen([program, str(journal)])
    try:
        return process.wait()
    except KeyboardInterrupt:
        return process.wait()  # it got the same signal


def _sample(search: Search, *, json: bool) -> None:
    """Print what trials may look like: the changed settings, and whether they make a spec."""
    from karolos.sweep.search import samples

    shown = list(samples(search.spec, min(search.asked, SAMPLES)))
    rows(
        [
            {
                "trial": place,
                **{key: drawn.get(key) for key in search.sweep.space},
                "problem": str(made) if isinstance(made, SpecError) else None,
                **({"spec": made.dump()} if json and not isinstance(made, SpecError) else {}),
            }
            for place, (drawn, made) in enumerate(shown)
        ],
        json=json,
    )
    each = f"{len(search.sweep.seeds)} seeds of {search.spec.training.steps:,} steps each"
    print(f"{search.asked} trials, {each}; nothing was run", file=sys.stderr)


class _Teller:
    """One line per trial, on stderr."""

    def __init__(self, objectives: tuple[str, ...], *, quiet: bool) -> None:
        self._objectives = objectives
        self._quiet = quiet

    def __call__(self, event: SweepEvent) -> None:
        from karolos.events import RunWarned
        from karolos.sweep.records import TrialBegan, TrialEnded

        if isinstance(event, RunWarned):
            self._say(f"{event.run}: {event.warning}")
        elif isinstance(event, TrialEnded) and event.trial.state == "failed":
            self._say(f"trial {event.trial.number} failed: {event.trial.error} [{event.done}/{event.asked}]")
        elif self._quiet:
            return
        elif isinstance(event, TrialBegan):
            self._say(f"trial {event.trial.number}: {_drawn(event.trial)}")
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


def _drawn(trial: Trial) -> str:
    return ", ".join(
        f"{key}={value:.4g}" if isinstance(value, float) else f"{key}={value}" for key, value in trial.drawn.items()
    )


def _report(outcome: Outcome, *, quiet: bool, json: bool) -> None:
    """The trials to stdout; what was chosen, and how far to trust it, to stderr."""
    if json or not quiet:
        rows([_row(trial, outcome) for trial in outcome.trials], json=json)
    if quiet:
        return
    for trial in outcome.front if len(outcome.objectives) > 1 else ():
        print(clean(f"no trial beats trial {trial.number} in every objective: {_drawn(trial)}"), file=sys.stderr)
    if outcome.best is None:
        print("no trial is complete yet", file=sys.stderr)
        return
    print(clean(f"best: trial {outcome.best.number}, {_drawn(outcome.best)}"), file=sys.stderr)
    if outcome.final is not None:
        _tell_final(outcome.final, outcome.objectives)
    print(f"`karolos run {outcome.folder / 'best.yaml'}` runs it; figures in {outcome.folder}", file=sys.stderr)


def _row(trial: Trial, outcome: Outcome) -> dict[str, Any]:
    """A trial as a row: objectives, the same on fresh and on unused seeds where it came so far, settings, runs."""
    row: dict[str, Any] = {"trial": trial.number, "state": trial.state}
    final = outcome.final
    for place, name in enumerate(outcome.objectives):
        row[name] = trial.values[place] if trial.values else None
        if final is not None:
            fresh = final.fresh.get(trial.number)
            row[f"{name}_fresh"] = fresh[place] if fresh else None
            unused = final.reported if trial.number == final.chosen else None
            row[f"{name}_unused"] = unused[place] if unused else None
    return {**row, **outcome.settings(trial), "error": trial.error, "runs": list(trial.runs)}


def _tell_final(final: Final, objectives: tuple[str, ...]) -> None:
    for place, name in enumerate(objectives):
        line = (
            f"{name}: {final.tuned[place]:.4g} on the seeds it was tuned on, "
            f"{final.fresh[final.chosen][place]:.4g} on {len(final.seeds)} fresh ones that it was chosen by"
        )
        if final.reported is not None:
            gap = final.tuned[place] - final.reported[place]
            line += f", {final.reported[place]:.4g} on {len(final.report_seeds)} used for nothing else: gap {gap:+.4g}"
        print(line, file=sys.stderr)
