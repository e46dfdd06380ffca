"""`karolos runs export` and `import`: runs as one file."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from karolos.report.terminal import clean

from ..common import Database, Json, Runs, rows
from ..selection import FILTER_HELP, MANY_HELP, open_store, select_runs


def export_runs(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A new .tar.gz or .zip.", show_default=False)],
    run: Annotated[list[str] | None, typer.Argument(metavar="[RUN]...", help=MANY_HELP, show_default=False)] = None,
    where: Annotated[str | None, typer.Option(metavar="FILTER", help=FILTER_HELP, show_default=False)] = None,
    checkpoints: Annotated[bool, typer.Option(help="Put the checkpoints in, which can be large.")] = True,
    runs: Runs = Path("runs"),
    database: Database = None,
) -> None:
    """Write run folders into an archive that `karolos runs import` takes in elsewhere."""
    from karolos.records import RunFolder, archive

    store, found = select_runs(run or (), where, runs, database)
    store.close()
    folders = [RunFolder.open(summary.folder) for summary in found]
    files = archive.export_runs(folders, file, checkpoints=checkpoints)
    print(f"{len(folders)} runs, {files} files, {file.stat().st_size / 1e6:.1f} MB in {file}", file=sys.stderr)


def import_runs(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="A .tar.gz or .zip.", show_default=False)],
    most: Annotated[float, typer.Option("--most", min=0, help="Gigabytes that an archive may unpack to.")] = 64.0,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Take runs in from an archive: all that are in it, or none. A run that is here already is refused."""
    from karolos.records import archive
    from karolos.store import Store

    runs.mkdir(parents=True, exist_ok=True)
    taken = []
    with open_store(runs, database) or Store(database or Store.default_url(runs)) as store:
        for file in files:
            came = archive.import_runs(
                file, runs, most_bytes=int(most * 1e9), known=lambda run: bool(store.runs(ids=[run]))
            )
            store.add_records([one.folder.record() for one in came])
            taken += [one.folder.summary() for one in came]
            for one in came:
                for problem in one.problems:
                    print(f"warning: {clean(one.folder.id)}: {clean(problem)}", file=sys.stderr)
    if json:
        rows([summary.row() for summary in taken], json=True)
        return
    for summary in taken:
        print(clean(summary.run))
