"""Options that several commands have, and the runs that an argument means."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from karolos.errors import UsageError

from .completion import complete_override, complete_policy, complete_policy_or_spec, complete_run, complete_spec
from .output import say, warn

if TYPE_CHECKING:
    from karolos.records import RunFolder
    from karolos.records.run_records import RunSummary
    from karolos.store import Store

RUN_HELP = "A run: its id, the beginning of its id, its folder, @last (the newest run) or @last-1 (the run before)."
MANY_HELP = (
    "One run: its id, the beginning of its id, its folder, @last or @last-2. Or all runs of an experiment: its name, "
    "the beginning of its hash, or a SPEC.yaml."
)
FILTER_HELP = (
    "Select matching runs, e.g. 'task=reach and agent.learning_rate<1e-3 and not state in (failed, lost)'. "
    "Operators: = != < <= > >= ~ (contains) in. Names: columns, settings of the spec, tags, note, "
    "versions.PACKAGE, measures.NAME."
)
POLICY_HELP = (
    f"{RUN_HELP} Or a shipped policy: panda_pick, ur5_throw, ... Write shipped:panda_pick if one of your runs has the"
    " same name."
)

Runs = Annotated[
    Path,
    typer.Option("--runs", metavar="FOLDER", envvar="KAROLOS_RUNS", help="Folder of the run folders.", file_okay=True),
]
Database = Annotated[
    str | None,
    typer.Option(
        "--database",
        metavar="URL",
        envvar="KAROLOS_DATABASE",
        help="SQLAlchemy URL of the results database. Default: karolos.sqlite in the runs folder.",
    ),
]
SpecFile = Annotated[
    Path,
    typer.Argument(
        metavar="SPEC",
        help="A YAML file, or the name of a shipped spec: see `karolos spec list`.",
        autocompletion=complete_spec,
    ),
]
Overrides = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[PATH=VALUE]...",
        help="Settings to change, e.g. agent.learning_rate=1e-4 seeds=[0,1].",
        autocompletion=complete_override,
    ),
]
OneRun = Annotated[str, typer.Argument(metavar="RUN", help=RUN_HELP, autocompletion=complete_run)]
APolicy = Annotated[str, typer.Argument(metavar="RUN", help=POLICY_HELP, autocompletion=complete_policy)]
PolicyOrSpec = Annotated[
    str,
    typer.Argument(
        metavar="RUN", help=f"{POLICY_HELP} With --expert: a SPEC.yaml.", autocompletion=complete_policy_or_spec
    ),
]
Changes = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[PATH=VALUE]...",
        help="Settings to change: of robot, task, environment, randomization or orchestrator, and parameters of the "
        "world, e.g. robot=ur5 task.object_mass=0.3 task.gravity=-5. With --expert: any setting.",
        autocompletion=complete_override,
    ),
]
ManyRuns = Annotated[list[str] | None, typer.Argument(metavar="[RUN]...", help=MANY_HELP, autocompletion=complete_run)]
Where = Annotated[str | None, typer.Option(metavar="FILTER", help=FILTER_HELP)]
On = Annotated[
    str | None,
    typer.Option(
        "--on",
        metavar="LAUNCHER",
        help="Where to run: local, ray, ray://HOST:PORT or slurm. Short for launcher.name=... launcher.address=...",
    ),
]
Jobs = Annotated[
    int | None,
    typer.Option(min=1, help="Runs at the same time, each in its own process. Default: 1; with --on: all."),
]
Resume = Annotated[bool, typer.Option("--resume", help="Resume interrupted runs and skip finished seeds.")]
IfNeeded = Annotated[bool, typer.Option("--if-needed", help="Skip finished seeds.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object per row.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show only warnings and failures.")]


Checkpoint = Annotated[
    Literal["best", "last"] | None,
    typer.Option(help="Checkpoint to use. Default: best; last if the run has no test yet."),
]
TimeLimit = Annotated[
    str | None,
    typer.Option(
        metavar="DURATION",
        help="Write a checkpoint and stop after this time, e.g. 90s, 30m, 2h. The exit code is then 124.",
    ),
]


def with_launcher(overrides: Sequence[str] | None, on: str | None) -> list[str]:
    """The overrides of a spec, with those of --on."""
    if on is None:
        return list(overrides or ())
    name, address, _ = on.partition("://")
    if ":" in name:
        hint = f"give --on ray://{on}, or on a machine of the cluster --on ray launcher.address={on}"
        raise UsageError(f"{on!r} is an address without its ray://", where="--on", hint=hint)
    return [*(overrides or ()), f"launcher.name={name}", *([f"launcher.address={on}"] if address else ())]


def open_store(runs: Path, database: str | None) -> Store | None:
    """The index, or None if there are no runs. A missing index is rebuilt from the run folders."""
    from karolos.store import open_index

    store, rebuilt = open_index(runs, database)
    if rebuilt is not None:
        say(f"the index was missing and is rebuilt from {rebuilt.runs} run folders")
        for problem in rebuilt.problems:
            warn(problem)
    return store


def open_or_make_store(runs: Path, database: str | None) -> Store:
    """The index; an empty one is created if there are no runs."""
    from karolos.store import Store

    return open_store(runs, database) or Store(database or Store.default_url(runs))


def open_run(selector: str, runs: Path, database: str | None) -> RunFolder:
    """The folder of the one run that a selector (POLICY_HELP) means.

    Raises UsageError if it means no run or several, RunError if the folder is missing or damaged.
    """
    from karolos.records import RunFolder
    from karolos.store.query import find_folder, is_run_folder

    if is_run_folder(selector):  # needs no index
        return RunFolder.open(selector)
    with open_store(runs, database) or nullcontext() as store:
        return find_folder(selector, store, runs)


def chosen_checkpoint(folder: RunFolder, asked: Literal["best", "last"] | None) -> Literal["best", "last"]:
    """The checkpoint to use: the requested one, or `best`; or, with a message, `last` if it is the only one."""
    from karolos.records.checkpoint import names
    from karolos.records.shipped import is_shipped

    if is_shipped(folder):
        if asked == "best":
            say(f"{folder.id} is shipped without the checkpoint best: using last")
        return "last"
    available = names(folder.checkpoints)
    if asked or "best" in available or "last" not in available:
        return asked or "best"
    say(f"{folder.id} was never tested and has no checkpoint best: using last")
    return "last"


def select_runs(
    selectors: Sequence[str], where: str | None, runs: Path, database: str | None
) -> tuple[Store, tuple[RunSummary, ...]]:
    """The open index, and the runs that any selector means and that match the filter, each once.

    Raises UsageError if neither is given, a selector means no run, or no run matches.
    """
    if not selectors and where is None:
        raise UsageError("which runs?", hint="name RUN, or give --where FILTER")
    from karolos.store.query import existing, select

    store = existing(open_store(runs, database), selectors[0] if selectors else str(where), runs)
    selected = {run.run: run for selector in selectors for run in select(store, selector)}
    if where is not None:
        matching = {run.run: run for run in store.runs(where=where)}
        selected = {run: matching[run] for run in selected if run in matching} if selectors else matching
    if not selected:
        raise UsageError("no runs match the filter", hint="`karolos runs list FILTER --trials` shows which runs match")
    return store, tuple(selected.values())


def in_folder(runs: Path) -> str:
    """The option, after a blank, that a suggested command needs to find this runs folder; nothing for the default."""
    return "" if runs.resolve() == Path("runs").resolve() else f" --runs {shlex.quote(str(runs))}"


def check_file(path: Path) -> None:
    """Raise UsageError if the folder of an output file is missing, before any work is done."""
    if not path.parent.is_dir():
        raise UsageError(f"there is no folder {path.parent}", where=str(path), hint="make it, or name another file")


LONGEST = 3650 * 86400.0
"""Longest duration in s. Clocks cannot represent much longer ones."""


def seconds(text: str | None, option: str = "--time-limit") -> float | None:
    """A duration such as 90, 90s, 30m, 2h or 1d in seconds. Raises UsageError for anything else."""
    if text is None:
        return None
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([smhd]?)", text.strip())
    if found is None or float(found[1]) <= 0:
        raise UsageError(f"{text!r} is not a duration", where=option, hint="write e.g. 90s, 30m, 2h or 1d")
    duration = float(found[1]) * {"": 1, "s": 1, "m": 60, "h": 3600, "d": 86400}[found[2]]
    if duration > LONGEST:
        raise UsageError(f"{text!r} is more than ten years", where=option, hint="leave it out")
    return duration
