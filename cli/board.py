"""`karolos board`: TensorBoard on the runs folder."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from karolos.errors import UsageError
from karolos.files import temporary_prefix

from .arguments import Runs

LINK_SECONDS = 5.0
"""Time between two looks for new runs."""


def board(
    runs: Runs = Path("runs"),
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port on this machine; 0 picks a free one.")] = 6006,
    trials: Annotated[bool, typer.Option("--trials", help="Show the runs of sweeps' trials, too.")] = False,
) -> None:
    """Start TensorBoard on the runs folder. Ctrl-C ends it."""
    if not runs.is_dir():
        raise UsageError(f"there is no runs folder {runs}", hint="run a spec first, or name the folder with --runs")
    with tempfile.TemporaryDirectory(prefix=temporary_prefix()) as links:
        folder = runs if trials else Path(links)
        command = [sys.executable, "-m", "tensorboard.main", "--logdir", str(folder), "--host", "localhost"]
        process = subprocess.Popen([*command, "--port", str(port)])
        code = None
        try:
            while code is None:
                if not trials:
                    link_runs(runs, folder)
                with suppress(subprocess.TimeoutExpired):
                    code = process.wait(None if trials else LINK_SECONDS)
        except KeyboardInterrupt:
            code = process.wait()  # it got the same signal
    raise typer.Exit(code if code >= 0 else 128 - code)


def link_runs(runs: Path, links: Path) -> None:
    """Link the TensorBoard folder of each run that is not of a sweep's trial into the folder `links`."""
    from karolos.records.sweep_records import names_of_trials

    names = names_of_trials(runs)
    for folder in runs.glob("*/tensorboard"):
        link = links / folder.parent.name
        if link.name.rpartition("-s")[0] not in names and not link.is_symlink():  # <name>-s<seed>-<time>
            link.symlink_to(folder.resolve(), target_is_directory=True)
