"""`karolos runs`: recorded runs and their results."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Annotated, Any

import typer

from karolos.errors import UsageError
from karolos.report.tables import (
    Table,
    counted,
    csv_text,
    evaluations_table,
    facts_table,
    measures_table,
    run_facts,
    runs_table,
    settings_table,
    stages_table,
    transfers_table,
)
from karolos.system.files import writing

from .arguments import (
    FILTER_HELP,
    MANY_HELP,
    APolicy,
    Database,
    Json,
    ManyRuns,
    OneRun,
    Runs,
    Where,
    in_folder,
    open_or_make_store,
    open_run,
    open_store,
    select_runs,
)
from .completion import complete_folder, complete_run, complete_tag
from .output import print_rows, print_table, say, warn

if TYPE_CHECKING:
    from karolos.records import RunFolder
    from karolos.records.evaluation import Evaluation
    from karolos.records.run_records import RunRecord, RunSummary
    from karolos.store import Store

app = typer.Typer(name="runs", help="List, show, label, stop, remove, export and import runs.", no_args_is_help=True)
STOP_SECONDS = 0.2
"""Time between two checks whether a run has stopped."""
WATCH_SECONDS = 2.0
"""Time between two tables of `runs list --watch`."""
LabelledRun = Annotated[str, typer.Argument(metavar="RUN", help=MANY_HELP, autocompletion=complete_run)]


@app.command("list")
def list_runs(
    where: Annotated[str | None, typer.Argument(metavar="[FILTER]", help=FILTER_HELP)] = None,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
    csv: Annotated[bool, typer.Option("--csv", help="Print comma-separated values with a header line.")] = False,
    state: Annotated[
        str | None,
        typer.Option(
            metavar="STATE", help="List runs in this state: created, running, finished, failed, stopped or lost."
        ),
    ] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="List only this number of the newest runs.")] = None,
    trials: Annotated[bool, typer.Option("--trials", help="Also list the runs of sweeps.")] = False,
    trash: Annotated[bool, typer.Option("--trash", help="List the runs in the trash.")] = False,
    watch: Annotated[
        bool, typer.Option("--watch", help="Show running and waiting runs live, until all have ended or until Ctrl-C.")
    ] = False,
    columns: Annotated[
        str | None,
        typer.Option(metavar="NAME,...", help="Show these columns: run, success_end, agent.learning_rate, ..."),
    ] = None,
    sort: Annotated[
        str | None, typer.Option(metavar="KEY", help="Sort by this column, smallest first. -KEY: largest first.")
    ] = None,
    group: Annotated[
        bool, typer.Option("--group", help="Print one row per experiment, with means over its seeds.")
    ] = False,
) -> None:
    """List runs, newest first, or experiments with means over their seeds."""
    chosen = {"a filter": where, "--state": state, "--limit": limit, "--columns": columns, "--sort": sort}
    chosen |= {"--csv": csv, "--json": json, "--group": group, "--trials": trials}
    given = [name for name, value in chosen.items() if value]
    exclusive = (("--csv", "--json"), ("--group", "--columns"))
    if both := next((pair for pair in exclusive if set(pair) <= set(given)), None):
        raise UsageError(f"{both[0]} cannot be combined with {both[1]}", hint=f"leave out {both[1]}")
    if watch:
        if given or trash:
            raise UsageError(f"--watch takes no {given[0] if given else '--trash'}")
        _watch(runs)
        return
    if trash:
        if given and given != ["--json"]:
            hint = "`karolos runs restore RUN` brings a run back"
            raise UsageError(f"--trash takes no {next(one for one in given if one != '--json')}", hint=hint)
        from karolos.records.trash import thrown_away

        paths = thrown_away(runs)
        if not paths:
            say(f"there are no runs in the trash of {runs}")
        print_rows([{"run": path.name, "folder": str(path)} for path in paths], json=json, line="{run}")
        return
    store = open_store(runs, database)
    if store is None:
        say(f"no runs in {runs} yet; `karolos run SPEC` makes one")
        return
    with store:
        found = store.runs(state=state, where=where, limit=limit, trials=None if trials else False)
        if not trials and store.runs(state=state, where=where, limit=1, trials=True):
            say("the runs of sweeps' trials are left out; --trials lists them")
        if not found:
            nothing = "no runs" + (f" are {state}" if state else " yet")
            say(nothing if where is None else "no runs match the filter")
        listed, rows = _rows(store, found, columns, sort, group=group)
    if csv:
        print(csv_text(rows), end="")
    elif json or group or columns is not None:
        print_rows(rows, json=json)
    elif rows:
        print_table(runs_table(listed))


def _rows(
    store: Store, found: Sequence[RunSummary], columns: str | None, sort: str | None, *, group: bool
) -> tuple[Sequence[RunSummary], list[dict[str, Any]]]:
    """The runs, sorted by a column, and a row for each, or for each experiment."""
    from karolos.store.query import column_values

    rows = _groups(found) if group else [run.row() for run in found]
    if columns is not None:
        rows = column_values(store, found, columns.split(","))
    if not sort or not rows:
        return found, rows
    key = sort.removeprefix("-")
    if group and key not in rows[0]:
        raise UsageError(f"there is no column {key!r} with --group", hint=f"one of {', '.join(rows[0])}")
    keys = [row[key] for row in (rows if group else column_values(store, found, [key]))]
    number = all(isinstance(value, int | float) for value in keys if value is not None)
    order = sorted(
        (place for place, value in enumerate(keys) if value is not None),
        key=lambda place: keys[place] if number else str(keys[place]),
        reverse=key != sort,
    )
    order += [place for place, value in enumerate(keys) if value is None]
    return [found[place] for place in order if not group], [rows[place] for place in order]


def _groups(found: Sequence[RunSummary]) -> list[dict[str, Any]]:
    """One row per experiment: its runs and states, and means over one finished run with a result per seed.

    `steps_to_95` is the median over runs with a success. A run that never reached it counts as infinite.
    """
    from karolos.comparison.contenders import averaged, name_of, repeated
    from karolos.comparison.reaching import median_reaching

    groups: dict[str, list[RunSummary]] = {}
    for run in found:
        groups.setdefault(run.experiment, []).append(run)
    rows = []
    for experiment, members in groups.items():
        name = name_of(members)
        seeds, left_out = averaged(members)
        for warning in (*repeated(name, members), *([f"{name}: {left_out}"] if left_out else ())):
            warn(warning)
        states = Counter(run.state for run in members)
        row = {"name": name, "experiment": experiment[:12], "runs": len(members)}
        row |= {"states": ", ".join(f"{count} {state}" for state, count in states.items())}
        for key in ("steps", "seconds", "success_end", "best_end", "mean_return"):
            known = [value for run in seeds if (value := getattr(run, key)) is not None]
            row[key] = fmean(known) if known else None
        reached = [run.steps_to_95 for run in seeds if run.success_end is not None]
        row["steps_to_95"] = median_reaching(reached)
        row["reached_95"] = f"{len(reached) - reached.count(None)} of {len(reached)}" if reached else None
        rows.append(row)
    return rows


def _watch(runs: Path) -> None:
    """Print a table of waiting and running runs, with machine and progress, until there are none."""
    from rich.console import Console

    from karolos.records import RunFolder, scan
    from karolos.system.files import read_object

    while True:
        rows = []
        for folder in scan(runs):
            if isinstance(folder, RunFolder) and (state := folder.state()).unfinished:
                host = (read_object(folder.launch) or {}).get("host", "-") if state.state == "running" else "-"
                steps = ((read_object(folder.progress) or {}).get("RunAdvanced") or {}).get("steps", state.steps)
                rows.append([folder.id, state.state, str(host), f"{steps:,}"])
        Console().clear()  # does nothing in a pipe
        if not rows:
            say(f"nothing runs in {runs}")
            return
        print_table(Table(["run", "state", "machine", "steps"], rows))
        time.sleep(WATCH_SECONDS)


@app.command()
def show(
    run: APolicy,
    everything: Annotated[
        bool,
        typer.Option("--all", help="Also show all tests and settings, checkpoints, versions, command and git commit."),
    ] = False,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Show a run: state, result with 95 % intervals, and the settings that are not defaults."""
    from karolos.core.environment import STAGE
    from karolos.records import RunFolder
    from karolos.records.shipped import results_of
    from karolos.store.query import existing, find_meant

    about: Mapping[str, Any] = {}
    final: Mapping[str, Evaluation] = {}
    transfers: Sequence[Evaluation] = ()
    checkpoints: Sequence[Mapping[str, Any]] = ()
    stages: Mapping[str, tuple[int, int]] = {}
    with open_store(runs, database) or nullcontext() as store:
        summary = find_meant(run, store, runs)
        if os.path.isdir(summary.folder):
            folder = RunFolder.open(summary.folder)
            record, about, tests, final = folder.record(), folder.description(), folder.tests(), folder.final()
            transfers, unreadable = results_of(folder, runs).transfers()
            stages = folder.stages(STAGE)
            checkpoints, damaged = _checkpoints(folder)
            problems = (*record.problems, *damaged, *unreadable)
        else:
            [record] = existing(store, run, runs).records([summary])
            tests = record.tests
            problems = (f"the run folder is missing: {summary.folder}",)
    if json:
        policies = {name: _test_row(final[name]) if name in final else None for name in ("last", "best")}
        row = record.summary.row() | {"tests": [_test_row(test, near=True) for test in tests]}
        row["final_test"] = {"seed": final["last"].seed, **policies} if final else None
        about = {key: about[key] for key in ("versions", "machine", "command", "git") if key in about}
        row["stages"] = {stage: {"episodes": n, "success_end": ended / n} for stage, (n, ended) in stages.items()}
        row |= {"transfers": [one.changed_row() for one in transfers], "checkpoints": checkpoints, "problems": problems}
        print_rows([row | {"spec": record.spec, **about}], json=True)
        return
    changed = None if everything else about.get("changed")
    print_table(
        facts_table(run_facts(record.summary, about if everything else {}, checkpoints if everything else None))
    )
    _print_results(tests, final, every=everything)
    if stages:
        print_table(stages_table(stages, title="the last training episodes, by the stage that they began in"))
    if transfers:
        print_table(transfers_table(transfers, title="tests under changed settings"))
    title = "spec" if changed is None else "settings that are not defaults"
    print_table(settings_table(record.spec if changed is None else changed, title))
    for problem in problems:
        warn(problem)
    if not everything:
        say("--all shows every test and setting, checkpoints, versions and the command")


@app.command()
def tag(
    run: LabelledRun,
    tags: Annotated[list[str], typer.Argument(metavar="TAG...", help="Any words.", autocompletion=complete_tag)],
    remove: Annotated[bool, typer.Option("--remove", help="Remove these tags.")] = False,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Add tags to a run, or to all runs of an experiment. `karolos runs list 'tags=good'` finds them."""
    from karolos.records import labels

    change = labels.remove_tags if remove else labels.add_tags
    same = "no run has such a tag" if remove else "all have these tags already"
    _relabel(run, lambda folder: change(folder, tags), runs, database, same=same, json=json)


@app.command()
def note(
    run: LabelledRun,
    text: Annotated[str | None, typer.Argument(metavar="[TEXT]", help="The new note.")] = None,
    remove: Annotated[bool, typer.Option("--remove", help="Remove the note.")] = False,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Set the note of a run, or of all runs of an experiment. It replaces the old note."""
    from karolos.records import labels

    if (text is None) != remove or text == "":
        raise UsageError("a note needs a text", hint="karolos runs note RUN TEXT, or --remove and no text")
    same = "no run has a note" if remove else "that is the note already"
    _relabel(run, lambda folder: labels.set_note(folder, text or ""), runs, database, same=same, json=json)


def _relabel(
    selector: str, change: Callable[[Path], bool], runs: Path, database: str | None, *, same: str, json: bool
) -> None:
    """Write into the run folders, and update the index. `same` says why no run changed."""
    from karolos.records import RunFolder

    store, found = select_runs([selector], None, runs, database)
    with store:
        folders = [RunFolder.open(run.folder) for run in found]
        changed = 0
        for folder in folders:
            changed += change(folder.path)
            store.refresh_labels(folder)
        if json:
            print_rows([folder.summary().row() for folder in folders], json=True)
            return
    say(f"{counted(changed, 'run')} changed" if changed else f"nothing changed: {same}")


@app.command("rm")
def remove(
    run: ManyRuns = None,
    where: Where = None,
    purge: Annotated[bool, typer.Option("--purge", help="Delete the whole trash permanently. Takes no RUN.")] = False,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Move runs to the trash (.trash in the runs folder). `karolos runs restore` brings them back."""
    from karolos.records import RunFolder, trash
    from karolos.store.store import behind

    if purge:
        if run or where:
            raise UsageError("--purge empties the trash and takes no RUN", hint="first rm RUN, then rm --purge")
        paths = trash.thrown_away(runs)
        for path in paths:
            trash.purge(path)
        say(f"{counted(len(paths), 'run')} removed for good")
        return
    store, found = select_runs(run or (), where, runs, database)
    with store:
        moved = []
        try:
            for summary in found:
                path = trash.throw_away(RunFolder.open(summary.folder))
                moved.append({"run": summary.run, "folder": str(path)})
                with behind(f"{summary.run} is in the trash"):
                    store.remove_runs([summary.run])
        finally:  # also the runs moved before the one that failed
            print_rows(moved, json=json, line="{run} -> {folder}")
    option = in_folder(runs)
    say(f"`karolos runs restore RUN{option}` brings them back, `karolos runs rm --purge{option}` empties the trash")


@app.command()
def stop(run: OneRun, runs: Runs = Path("runs"), database: Database = None) -> None:
    """Write a checkpoint and stop a run, whatever started it. Other seeds of its experiment go on.

    The command waits until the run has stopped. Ctrl-C ends the waiting; the run still stops.
    """
    from karolos.system.files import write_whole

    folder = open_run(run, runs, database)
    if (state := folder.summary().state) != "running":
        raise UsageError(f"{folder.id} is {state}: there is nothing to stop", hint="`karolos runs list --watch`")
    write_whole(folder.stop, "karolos runs stop")
    say(f"{folder.id} writes a checkpoint and stops")
    while folder.summary().state == "running":
        time.sleep(STOP_SECONDS)
    say(f"{folder.id} is {folder.summary().state}; `karolos resume {folder.id}{in_folder(runs)}` continues it")


@app.command()
def restore(
    run: Annotated[
        list[str],
        typer.Argument(
            metavar="RUN...", help="The run's id or its beginning.", autocompletion=complete_folder(".trash/*/run.json")
        ),
    ],
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Move runs out of the trash, with their tests, tags and note."""
    from karolos.records import trash
    from karolos.store.store import behind

    paths = list(dict.fromkeys(trash.find(runs, selector) for selector in run))
    moved = []
    with open_or_make_store(runs, database) as store:
        for path in paths:
            folder = trash.restore(path)
            record = folder.record()
            with behind(f"{folder.id} is out of the trash"):
                store.add_records([record])
            moved.append({"run": folder.id, "folder": str(folder.path)})
            for problem in record.problems:
                warn(f"{folder.id}: {problem}")
    print_rows(moved, json=json, line="{run} -> {folder}")


@app.command("export")
def export_runs(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Archive to write: a new .tar.gz.")],
    run: ManyRuns = None,
    where: Where = None,
    checkpoints: Annotated[bool, typer.Option(help="Include checkpoints, which can be large.")] = True,
    without_source: Annotated[
        bool,
        typer.Option(
            "--without-source",
            help="Leave out code.diff, commands, tracebacks, names of untracked files, and folders of absolute paths.",
        ),
    ] = False,
    runs: Runs = Path("runs"),
    database: Database = None,
) -> None:
    """Write run folders into an archive. `karolos runs import` reads it on another machine."""
    from karolos.records import RunFolder, archive

    store, found = select_runs(run or (), where, runs, database)
    store.close()
    folders = [RunFolder.open(summary.folder) for summary in found]
    exported = archive.export_runs(folders, file, checkpoints=checkpoints, source=not without_source)
    for name in exported.left_out:
        warn(f"{name}: not a file of a run; left out")
    counts = f"{counted(len(folders), 'run')}, {counted(exported.files, 'file')}"
    say(f"{counts}, {file.stat().st_size / 1e6:.1f} MB in {file}")
    source = "" if without_source else "; uncommitted changes, commands and untracked names (--without-source: none)"
    say(f"it holds settings, results and events{' with checkpoints' * checkpoints}{source}; secrets as ***")


@app.command("import")
def import_runs(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Archives: .tar.gz.")],
    most: Annotated[
        float, typer.Option("--most", min=0, help="Largest allowed size of an unpacked archive, in gigabytes.")
    ] = 64.0,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Read all runs of an archive into the runs folder. If one of them already exists, none is read."""
    from karolos.records import archive

    with writing(runs):
        runs.mkdir(parents=True, exist_ok=True)
    imported: list[RunRecord] = []
    with open_or_make_store(runs, database) as store:

        def enter(records: Sequence[RunRecord]) -> None:
            if known := store.runs(ids=[record.summary.run for record in records]):
                raise UsageError(f"the run {known[0].run} exists already", hint="`karolos runs rm` removes it")
            store.add_records(records)

        for file in files:
            imported += archive.import_runs(file, runs, most_bytes=int(most * 1e9), enter=enter)
    for record in imported:
        for problem in record.problems:
            warn(f"{record.summary.run}: {problem}")
    print_rows([record.summary.row() for record in imported], json=json, line="{run}")


@app.command("push")
def push_runs(
    selectors: ManyRuns = None,
    to: Annotated[
        str | None,
        typer.Option(
            metavar="TRACKER",
            envvar="KAROLOS_TRACKING",
            help="Tracker: mlflow, wandb or trackio. Default: that of the run's spec.",
        ),
    ] = None,
    where: Where = None,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Send runs to a tracker: tests, settings and records. A run that the tracker has gets the missing parts."""
    from karolos.experiment.tracking import push, tracker_of
    from karolos.records import RunFolder

    store, found = select_runs(selectors or (), where, runs, database)
    rows = []
    with store:
        for run in found:
            folder = RunFolder.open(run.folder)
            name = to or tracker_of(folder)
            if name is None:
                hint = "name one with --to: mlflow, wandb or trackio"
                raise UsageError("its spec names no tracker", where=run.run, hint=hint)
            push(name, folder)
            rows.append({"run": run.run, "tracker": name})
    print_rows(rows, json=json, line="{run}")


def _test_row(test: Evaluation, *, near: bool = False) -> dict[str, Any]:
    from karolos.records.evaluation import WITHIN

    row = {"steps": test.steps, "seconds": test.seconds, **test.row(), "solved_at_reset": test.solved_at_reset}
    return row | ({"within_m": {f"{far:g}": test.within(far) for far in WITHIN}} if near and test.distances else {})


def _checkpoints(folder: RunFolder) -> tuple[list[dict[str, Any]], list[str]]:
    """The metadata of readable checkpoints, and the errors of the others."""
    from karolos.records import checkpoint

    found, problems = [], []
    for name in checkpoint.names(folder.checkpoints):
        try:
            found.append({"name": name, **checkpoint.read_meta(folder.checkpoints, name)})
        except checkpoint.CheckpointError as error:
            problems.append(str(error))
    return found, problems


def _print_results(tests: Sequence[Evaluation], final: Mapping[str, Evaluation], *, every: bool) -> None:
    """Print the final test, or the last test before it; or every test."""
    if not tests:
        print("\nno tests yet")
    elif every or not final:
        print_table(evaluations_table(tests if every else tests[-1:], title="tests" if every else "last test"))
    if final:
        print_table(evaluations_table(final.values(), title=f"final test, from seed {final['last'].seed}"))
    shown = final.get("last", tests[-1] if tests else None)
    if shown is not None and shown.any and shown.measures:
        title = "measures of the last policy in the final test" if final else "measures of the last test"
        print_table(measures_table(shown.measures, title))
