"""`karolos sweep`: search for good settings."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from karolos.errors import MachineError, SpecError, UsageError

from .common import Database, Json, Overrides, Runs, rows
from .run import TimeLimit, seconds
from .sweep_output import Teller, report

if TYPE_CHECKING:
    from karolos.sweep.search import Search

SAMPLES = 5
"""Sampled specs that --dry-run prints at most."""
DASHBOARD = "optuna-dashboard"


def sweep(
    spec: Annotated[Path, typer.Argument(metavar="SPEC", help="A YAML spec with a sweep.", show_default=False)],
    overrides: Overrides = None,
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
    teller = Teller(search.sweep.objectives, quiet=quiet)
    outcome = search.run(runs, database=database, jobs=jobs, time_limit=seconds(time_limit), listener=teller)
    report(outcome, quiet=quiet, json=json)
    raise typer.Exit(outcome.exit_code)


def _open_dashboard(journal: Path) -> int:
    program = shutil.which(DASHBOARD) or shutil.which(DASHBOARD, path=str(Path(sys.executable).parent))
    if program is None:
        raise MachineError(f"{DASHBOARD} is not installed", hint=f"`pip install {DASHBOARD}`, then try again")
    if not journal.is_file():
        raise UsageError(f"there is no sweep at {journal.parent} yet", hint="`karolos sweep SPEC` begins one")
    from karolos.experiment.jobs import sigint_ignored

    with sigint_ignored():  # inherited: at Ctrl-C, which is how one leaves it, it would end with a traceback
        process = subprocess.Popen([program, str(journal)])
    try:
        return process.wait()
    except KeyboardInterrupt:
        process.terminate()
        process.wait()
        return 0


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
