"""`karolos sweep`: search for good settings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from karolos.errors import KarolosError

from .arguments import Database, Json, On, Overrides, Quiet, Runs, SpecFile, TimeLimit, seconds, with_launcher
from .output import drawn_text, print_rows, say, short_text, warn

if TYPE_CHECKING:
    from karolos.records.sweep_records import SweepRecord, Trial
    from karolos.sweep.events import SweepOutcome
    from karolos.sweep.search import Search

SAMPLES = 5
"""Most sampled specs that --dry-run prints."""


def sweep(
    spec: SpecFile,
    overrides: Overrides = None,
    runs: Runs = Path("runs"),
    database: Database = None,
    trials: Annotated[int | None, typer.Option(min=1, help="Trials in total, instead of the spec's number.")] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Trials at the same time. Each seed of each is a process.")] = 1,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check the search and print its first trials.")] = False,
    on: On = None,
    time_limit: TimeLimit = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Search the settings that SPEC's sweep names, and write the best as a spec.

    Each trial is the spec with other values, run on the sweep's seeds as ordinary runs. The same command resumes a
    sweep that was interrupted. The sweep's folder is sweeps/NAME in the runs folder; best.yaml is in it.
    """
    from karolos.specification import load_spec

    found = load_spec(spec, with_launcher(overrides, on))
    from karolos.sweep.search import Search

    from . import display

    search = Search(found, trials=trials)
    if dry_run:
        _print_samples(search, json=json)
        return
    with display.Quiet() if quiet else display.SweepDisplay(search.sweep.objectives) as listener:
        outcome = search.run(runs, database=database, jobs=jobs, time_limit=seconds(time_limit), listener=listener)
    report(outcome, quiet=quiet, json=json)
    raise typer.Exit(outcome.exit_code)


def report(outcome: SweepOutcome, *, quiet: bool, json: bool) -> None:
    """Print the trials on stdout, and the best of them on stderr."""
    if json:
        print_rows((_trial_row(one, outcome) for one in outcome.trials), json=True)
    elif not quiet:
        print_trials(outcome)
    if not quiet:
        for trial in outcome.front if len(outcome.objectives) > 1 else ():
            say(f"no trial is better than trial {trial.number} in every objective: {drawn_text(trial)}")
        report_best(outcome)


def _trial_row(trial: Trial, sweep: SweepRecord) -> dict[str, Any]:
    """A trial as a row: state, objectives, settings, error, runs.

    After the final choice there are two more columns per objective: on the fresh seeds that the choice was made on, and
    on the unused seeds that only the chosen trial was run on.
    """
    row: dict[str, Any] = {"trial": trial.number, "state": trial.state}
    final = sweep.final
    for place, name in enumerate(sweep.objectives):
        row[name] = trial.values[place] if trial.values else None
        if final is not None:
            fresh = final.fresh.get(trial.number)
            row[f"{name}_fresh"] = fresh[place] if fresh else None
            unused = final.reported if trial.number == final.chosen else None
            row[f"{name}_unused"] = unused[place] if unused else None
    settings = {key: trial.drawn.get(key) for key in sweep.parameters}  # None for a setting that the trial did not draw
    return {**row, **settings, "error": trial.error, "runs": list(trial.runs)}


def print_trials(sweep: SweepRecord) -> None:
    """Print a table of trials, without runs, errors and `unused`.

    A trial that has not ended is `open` unless the sweep is running: it waits until the sweep is resumed.
    """
    running = sweep.state() == "running"
    left_out = ("error", "runs", *(f"{name}_unused" for name in sweep.objectives))
    rows = []
    for row in (_trial_row(trial, sweep) for trial in sweep.trials):
        row["state"] = "open" if row["state"] == "running" and not running else row["state"]
        rows.append({name: short_text(value, 3) for name, value in row.items() if name not in left_out})
    print_rows(rows, json=False)


def report_best(sweep: SweepRecord) -> None:
    """Print the best trial on stderr: its settings, how good it is on which seeds, and how to run it."""
    best, final, path = sweep.best, sweep.final, Path(sweep.folder) / "best.yaml"
    if best is None:
        say("no trial is complete yet")
        return
    say(f"best: trial {best.number}, {drawn_text(best)}")
    if final is not None:
        for place, name in enumerate(sweep.objectives):
            tuned, fresh = final.tuned[place], final.fresh[final.chosen][place]
            line = f"{name}: {tuned:.4g} on the seeds it was tuned on, {fresh:.4g} on {len(final.seeds)} fresh seeds "
            line += "that it was chosen by"
            if final.reported is not None:
                unused = final.reported[place]
                line += f", {unused:.4g} on {len(final.report_seeds)} used for nothing else: gap {tuned - unused:+.4g}"
            say(line)
    if path.is_file():
        say(f"`karolos run {path}` runs it; figures in {path.parent}")


def _print_samples(search: Search, *, json: bool) -> None:
    """Print the first trials: the changed settings, and whether the spec with them is valid.

    Raises UsageError as the search itself if its parts are incompatible, or the environment lacks an objective.
    """
    from karolos.sweep.search import samples
    from karolos.sweep.study import STARTUP_TRIALS
    from karolos.training.assembly import check_parts

    if (note := check_parts(search.spec)) is not None:
        warn(note)
    rows = []
    for place, (drawn, made) in enumerate(samples(search.spec, min(search.asked, SAMPLES))):
        row = {"trial": place, **{key: drawn.get(key) for key in search.sweep.space}}
        if isinstance(made, KarolosError):
            row["problem"] = str(made)
        else:
            row |= {"problem": None} | ({"spec": made.dump()} if json else {})
        rows.append(row)
    print_rows(rows, json=json)
    each = f"{len(search.sweep.seeds)} seeds of {search.spec.training.steps:,} steps each"
    say(f"{search.asked} trials, {each}; nothing was run")
    if search.sweep.sampler in ("tpe", "gp") and search.asked > STARTUP_TRIALS:
        say(f"these are the first; from trial {STARTUP_TRIALS} on, values depend on results")
