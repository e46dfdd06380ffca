"""`karolos runs`: what was run, and with which results."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from karolos.errors import UsageError

from .arguments import (
    FILTER_HELP,
    MANY_HELP,
    Database,
    Json,
    ManyRuns,
    OneRun,
    Runs,
    Where,
    find_run,
    open_or_make_store,
    open_store,
    select_runs,
)
from .completion import complete_run
from .output import print_csv, print_rows, print_table, say, warn

if TYPE_CHECKING:
    from karolos.records import RunFolder
    from karolos.records.final_test import FinalTest
    from karolos.records.results import TestCounts, TestResult
    from karolos.records.run_records import RunRecord, RunSummary
    from karolos.records.transfer_results import TransferResult
    from karolos.store import Store

app = typer.Typer(
    name="runs", help="List, show, label and remove runs; write them to an archive and read one.", no_args_is_help=True
)
WATCH_SECONDS = 2.0
"""Time between two tables of `runs list --watch`."""
LabelledRun = Annotated[str, typer.Argument(metavar="RUN", help=MANY_HELP, autocompletion=complete_run)]


@app.command("list")
def list_runs(
    where: Annotated[str | None, typer.Argument(metavar="[FILTER]", help=FILTER_HELP)] = None,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
    csv: Annotated[bool, typer.Option("--csv", help="Print comma-separated values with a line of names.")] = False,
    state: Annotated[
        str | None,
        typer.Option(metavar="STATE", help="Only runs that are created, running, finished, failed, stopped or lost."),
    ] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Only this number of runs, the newest.")] = None,
    trials: Annotated[bool, typer.Option("--trials", help="List the runs of sweeps' trials, too.")] = False,
    trash: Annotated[bool, typer.Option("--trash", help="List the runs in the trash instead.")] = False,
    watch: Annotated[
        bool, typer.Option("--watch", help="Show what runs where, until Ctrl-C or until no run waits or runs.")
    ] = False,
    columns: Annotated[
        str | None,
        typer.Option(metavar="NAME,...", help="Only these columns: run, success_end, agent.learning_rate, ..."),
    ] = None,
) -> None:
    """List runs, the newest first."""
    if watch:
        _watch(runs)
        return
    if trash:
        if where or state or csv:
            hint = "`karolos runs restore RUN` brings a run back"
            raise UsageError("--trash takes no filter, state or --csv", hint=hint)
        _list_trash(runs, json=json)
        return
    store = open_store(runs, database)
    if store is None:
        say(f"no runs in {runs} yet; `karolos run SPEC` makes one")
        return
    with store:
        found = store.runs(state=state, where=where, limit=limit, trials=None if trials else False)
        if not trials and store.runs(state=state, where=where, limit=1, trials=True):
            say("the runs of sweeps' trials are left out; --trials lists them")
        like = store.closest_value(where) if where is not None and not found else None
        rows = [run.row() for run in found] if columns is None else _columns(store, found, columns)
    if json:
        print_rows(rows, json=True)
    elif csv:
        print_csv(rows)
    elif found and columns is not None:
        from karolos.report.tables import Table, setting

        print_table(Table(list(rows[0]), [[setting(value) for value in row.values()] for row in rows]))
    elif found:
        from karolos.report.tables import runs_table

        print_table(runs_table(found))
    elif where is not None:
        say("no runs match the filter" + (f": {like}" if like else ""))
    else:
        say("no runs" + (f" are {state}" if state else " yet"))


def _columns(store: Store, found: Sequence[RunSummary], columns: str) -> list[dict[str, Any]]:
    from karolos.store.query import column_values

    return column_values(store, found, columns.split(","))


def _watch(runs: Path) -> None:
    """Print a table of the runs that wait or run, with their machine and progress, until there are none."""
    from rich.console import Console

    from karolos.files import read_object
    from karolos.records import RunFolder, scan
    from karolos.report.tables import Table

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


def _list_trash(runs: Path, *, json: bool) -> None:
    from karolos.records import trash

    paths = trash.thrown_away(runs)
    if not paths:
        say(f"there are no runs in the trash of {runs}")
    print_rows([{"run": path.name, "folder": str(path)} for path in paths], json=json, line="{run}")


@app.command()
def show(run: OneRun, runs: Runs = Path("runs"), database: Database = None, json: Json = False) -> None:
    """Show a run: state, tests with 95 % intervals, spec, checkpoints, versions, command and git commit."""
    store, summary = find_run(run, runs, database)
    with store:
        if os.path.isdir(summary.folder):
            view = _from_folder(summary.folder)
        else:
            problem = f"the run folder is missing: {summary.folder}"
            view = _View(replace(store.records([summary])[0], problems=(problem,)))
    if json:
        print_rows([view.row()], json=True)
    else:
        _print_view(view)


@app.command()
def tag(
    run: LabelledRun,
    tags: Annotated[list[str], typer.Argument(metavar="TAG...", help="Words of your own.")],
    remove: Annotated[bool, typer.Option("--remove", help="Remove these tags instead.")] = False,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Add tags to a run, or to all runs of an experiment. `karolos runs list 'tags=good'` finds them."""
    from karolos.records import labels

    change = labels.remove_tags if remove else labels.add_tags
    _relabel(run, lambda folder: change(folder, tags), runs, database, json=json)


@app.command()
def note(
    run: LabelledRun,
    text: Annotated[str | None, typer.Argument(metavar="[TEXT]", help="The new note.")] = None,
    remove: Annotated[bool, typer.Option("--remove", help="Remove the note.")] = False,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Set the note of a run, or of all runs of an experiment. It replaces the note before."""
    from karolos.records import labels

    if (text is None) != remove or text == "":
        raise UsageError("a note needs a text", hint="karolos runs note RUN TEXT, or --remove and no text")
    _relabel(run, lambda folder: labels.set_note(folder, text or ""), runs, database, json=json)


def _relabel(selector: str, change: Callable[[Path], None], runs: Path, database: str | None, *, json: bool) -> None:
    """Write into the run folders, and let the index read them again."""
    from karolos.records import RunFolder

    store, found = select_runs([selector], None, runs, database)
    with store:
        folders = [RunFolder.open(run.folder) for run in found]
        for folder in folders:
            change(folder.path)
            store.refresh_labels(folder)
        if json:
            print_rows([folder.summary().row() for folder in folders], json=True)
            return
    say(f"{len(folders)} run{'s' if len(folders) > 1 else ''} changed")


@app.command("rm")
def remove(
    run: ManyRuns = None,
    where: Where = None,
    purge: Annotated[bool, typer.Option("--purge", help="Empty the trash for good. Takes no RUN.")] = False,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Move runs to the trash (.trash in the runs folder). `karolos runs restore` brings them back."""
    from karolos.records import RunFolder, trash

    if purge:
        if run or where:
            raise UsageError("--purge empties the trash and takes no RUN", hint="first rm RUN, then rm --purge")
        paths = trash.thrown_away(runs)
        for path in paths:
            trash.purge(path)
        say(f"{len(paths)} runs removed for good")
        return
    store, found = select_runs(run or (), where, runs, database)
    with store:
        moved = []
        for summary in found:
            path = trash.throw_away(RunFolder.open(summary.folder))
            store.remove_runs([summary.run])
            moved.append({"run": summary.run, "folder": str(path)})
    print_rows(moved, json=json, line="{run} -> {folder}")
    say("`karolos runs restore RUN` brings them back, `karolos runs rm --purge` empties the trash")


@app.command()
def restore(
    run: Annotated[list[str], typer.Argument(metavar="RUN...", help="The run's id or its beginning.")],
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Move runs out of the trash, with their tests, tags and note."""
    from karolos.records import trash

    paths = list(dict.fromkeys(trash.find(runs, selector) for selector in run))
    moved = []
    with open_or_make_store(runs, database) as store:
        for path in paths:
            folder = trash.restore(path)
            record = folder.record()
            store.add_records([record])
            moved.append({"run": folder.id, "folder": str(folder.path)})
            for problem in record.problems:
                warn(f"{folder.id}: {problem}")
    print_rows(moved, json=json, line="{run} -> {folder}")


@app.command("export")
def export_runs(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A new .tar.gz.")],
    run: ManyRuns = None,
    where: Where = None,
    checkpoints: Annotated[bool, typer.Option(help="Include the checkpoints, which can be large.")] = True,
    runs: Runs = Path("runs"),
    database: Database = None,
) -> None:
    """Write run folders into an archive, which `karolos runs import` reads on another machine."""
    from karolos.records import RunFolder, archive

    store, found = select_runs(run or (), where, runs, database)
    store.close()
    folders = [RunFolder.open(summary.folder) for summary in found]
    exported = archive.export_runs(folders, file, checkpoints=checkpoints)
    for name in exported.left_out:
        warn(f"{name}: not a file of a run; left out")
    say(f"{len(folders)} runs, {exported.files} files, {file.stat().st_size / 1e6:.1f} MB in {file}")


@app.command("import")
def import_runs(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="A .tar.gz.")],
    most: Annotated[float, typer.Option("--most", min=0, help="Most gigabytes that an archive may unpack to.")] = 64.0,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Read runs from an archive into the runs folder: all of them or none. A run that already exists is refused."""
    from karolos.records import archive

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


@dataclass(frozen=True)
class _View:
    """Everything known about one run."""

    record: RunRecord
    results: Sequence[TestResult] = ()
    """The tests episode by episode, as far as the folder has them."""
    final: FinalTest | None = None
    transfers: Sequence[TransferResult] = ()
    """Tests under changed settings (`karolos test`)."""
    checkpoints: Sequence[Mapping[str, Any]] = ()
    about: Mapping[str, Any] = field(default_factory=dict)
    """Versions, machine, command and git commit."""

    def row(self) -> dict[str, Any]:
        from karolos.records.results import WITHIN

        known = [result for result in self.results if result.distances]
        near = {one.steps: {"within_m": {f"{far:g}": one.within(far) for far in WITHIN}} for one in known}
        return {
            **self.record.summary.row(),
            "tests": [_test_row(test) | near.get(test.steps, {}) for test in self.record.tests],
            "final_test": None if self.final is None else _final_row(self.final),
            "transfers": [transfer.row() for transfer in self.transfers],
            "checkpoints": self.checkpoints,
            "problems": self.record.problems,
            "spec": self.record.spec,
            **self.about,
        }


def _test_row(test: TestCounts) -> dict[str, Any]:
    return {"steps": test.steps, "seconds": test.seconds, **test.row(), "solved_at_reset": test.solved_at_reset}


def _final_row(final: FinalTest) -> dict[str, Any]:
    from karolos.records.results import TestCounts

    policies = {"last": final.last, "best": final.best}
    return {"seed": final.seed} | {
        name: None if result is None else _test_row(TestCounts.of(result)) for name, result in policies.items()
    }


def _from_folder(path: str) -> _View:
    from karolos.records import RunFolder, transfer_results

    folder = RunFolder.open(path)
    record, description = folder.record(), folder.description()
    checkpoints, damaged = _checkpoints(folder)
    transfers, unreadable = transfer_results.read(folder)
    return _View(
        replace(record, problems=(*record.problems, *damaged, *unreadable)),
        folder.tests(),
        folder.final(),
        transfers,
        checkpoints,
        {key: description.get(key) for key in ("versions", "machine", "command", "git")},
    )


def _checkpoints(folder: RunFolder) -> tuple[list[dict[str, Any]], list[str]]:
    """The metadata of the checkpoints that can be read, and what is wrong with the others."""
    from karolos import checkpoint

    found, problems = [], []
    for name in checkpoint.names(folder.checkpoints):
        try:
            found.append({"name": name, **checkpoint.read_meta(folder.checkpoints, name)})
        except checkpoint.CheckpointError as error:
            problems.append(str(error))
    return found, problems


def _print_view(view: _View) -> None:
    from karolos.records.results import TestCounts
    from karolos.report.tables import duration, facts_table, flatten, run_state, table_of_tests, transfers_table

    run, about = view.record.summary, view.about
    git = about.get("git") or {}
    commit = f"{git.get('commit', '')[:12]}{' with changes (code.diff)' if git.get('dirty') else ''}" if git else None
    solved = None if run.steps_to_95 is None else f"{run.steps_to_95:,} steps, {duration(run.seconds_to_95)}"
    checkpoints = ", ".join(f"{point['name']} ({point.get('steps', 0):,} steps)" for point in view.checkpoints)
    facts = {
        "run": run.run,
        "state": run_state(run) if run.error is None else f"{run.state}: {run.error}",
        "experiment": run.experiment,
        "steps": f"{run.steps:,}, {duration(run.seconds)} of collecting and learning",
        "total": duration(run.total_seconds),
        "to .95, end": solved,
        "created": run.created,
        "updated": run.updated,
        "folder": run.folder,
        "tags": ", ".join(run.tags) or None,
        "note": run.note,
        "checkpoints": checkpoints or "none",
        "command": " ".join(about.get("command") or ()) or None,
        "git commit": commit,
        "versions": ", ".join(f"{name} {version}" for name, version in (about.get("versions") or {}).items()) or None,
    }
    print_table(facts_table(facts))
    if view.record.tests:
        print_table(table_of_tests(view.record.tests, view.results, title="tests"))
    else:
        print("\nno tests yet")
    if view.final is not None:
        policies = [result for result in (view.final.last, view.final.best) if result is not None]
        title = f"final test of last{' and of best' if view.final.best else ''}, from seed {view.final.seed}"
        print_table(table_of_tests(map(TestCounts.of, policies), policies, title=title))
    if view.transfers:
        print_table(transfers_table(view.transfers, title="tests under changed settings"))
    print_table(facts_table(dict(flatten(view.record.spec)), title="spec"))
    for problem in view.record.problems:
        warn(problem)
