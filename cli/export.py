"""`karolos export`: a run's saved policy for use without karolos."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .common import RUN_HELP, Database, Json, Runs, rows
from .selection import check_checkpoint, open_run


def export(
    run: Annotated[str, typer.Argument(metavar="RUN", help=RUN_HELP, show_default=False)],
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Folder to write to. Default: export in the run's folder.", show_default=False),
    ] = None,
    checkpoint: Annotated[str, typer.Option(help="Which checkpoint to export: best or last.")] = "best",
    onnx: Annotated[bool, typer.Option(help="Write policy.onnx too; needs the package onnx.")] = True,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Write a run's policy for use without karolos: as ONNX, and as arrays that numpy reads.

    Normalising the inputs is inside. Inputs are observation and desired_goal, the output is an action in [-1, 1], or
    the index of one of a discrete set; policy.json says what each number means.
    """
    check_checkpoint(checkpoint)
    folder = open_run(run, runs, database)
    from karolos.export import export_policy

    done = export_policy(folder, out or folder.path / "export", checkpoint=checkpoint, onnx=onnx)
    row = {"run": folder.id, "checkpoint": checkpoint, "steps": done.steps, "folder": str(done.folder)}
    files = [path.name for path in done.files]
    row |= {"files": files if json else " ".join(files), "error": done.error}
    rows([row], json=json)
