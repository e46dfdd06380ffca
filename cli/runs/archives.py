"""`karolos runs export` and `import`: runs as one file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..arguments import Database, Json, ManyRuns, Runs, Where, open_store, select_runs
from ..output import print_line, print_rows, say, warn


def export_runs(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A new .tar.gz or .zip.", show_default=False)],
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
    files = archive.export_runs(folders, file, checkpoints=checkpoints)
    say(f"{len(folders)} runs, {files} files, {file.stat().st_size / 1e6:.1f} MB in {file}")


def import_runs(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="A .tar.gz or .zip.", show_default=False)],
    most: Annotated[float, typer.Option("--most", min=0, help="Most gigabytes that an archive may unpack to.")] = 64.0,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Read runs from an archive into the runs folder: all of them or none. A run that already exists is refused."""
    from karolos.records import archive
    from karolos.store import Store

    runs.mkdir(parents=True, exist_ok=True)
    summaries = []
    with open_store(runs, database) or Store(database or Store.default_url(runs)) as store:
        for file in files:
            imported = archive.import_runs(
                file, runs, most_bytes=int(most * 1e9), known=lambda run: bool(store.runs(ids=[run]))
            )
            store.add_records([one.folder.record() for one in imported])
            summaries += [one.folder.summary() for one in imported]
            for one in imported:
                for problem in one.problems:
                    warn(f"{one.folder.id}: {problem}")
    if json:
        print_rows([summary.row() for summary in summaries], json=True)
        return
    for summary in summaries:
        print_line(summary.run)
