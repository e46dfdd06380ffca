"""`karolos export`: a run's saved policy for use without karolos."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .arguments import APolicy, Checkpoint, Database, Json, Runs, chosen_checkpoint, open_run
from .output import print_rows, warn


def export(
    run: APolicy,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FOLDER",
            help="Folder to write. Default: export in the run's folder, or NAME of a policy that ships.",
        ),
    ] = None,
    checkpoint: Checkpoint = None,
    onnx: Annotated[
        bool | None,
        typer.Option("--onnx/--no-onnx", help="Write policy.onnx too. Default: if the package onnx is installed."),
    ] = None,
    card: Annotated[bool, typer.Option("--card", help="Write README.md for the Hugging Face hub, too.")] = False,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Write a run's policy for use without karolos: as an ONNX model, and as arrays for numpy.

    The files include the normalisation of inputs. The inputs are observation and desired_goal. The output is an action
    in [-1, 1], or the index of a discrete action. policy.json says what each number means.
    """
    folder = open_run(run, runs, database)
    from karolos.export.card import write_card
    from karolos.export.export import export_policy
    from karolos.records.shipped import is_shipped

    out = out or (Path(run) if is_shipped(folder) else folder.path / "export")
    done = export_policy(folder, out, checkpoint=chosen_checkpoint(folder, checkpoint), onnx=onnx)
    row = {"run": folder.id, "checkpoint": done.checkpoint, "steps": done.steps, "folder": str(done.folder)}
    files = [path.name for path in done.files]
    files += [write_card(folder, done.checkpoint, done.folder).name] if card else []
    row |= {"files": files if json else " ".join(files), "error": done.error}
    print_rows([row], json=json)
    if onnx is None and "policy.onnx" not in files:
        warn("policy.onnx was not written, because the package onnx is missing; pip install 'karolos[onnx]' adds it")
