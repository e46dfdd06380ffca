"""`karolos board`: TensorBoard on the runs folder."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer

from karolos.errors import UsageError

from .arguments import Runs


def board(
    runs: Runs = Path("runs"),
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port on this machine. 0: any free port.")] = 6006,
) -> None:
    """Start TensorBoard on the runs folder. Ctrl-C ends it."""
    if not runs.is_dir():
        raise UsageError(f"there is no runs folder {runs}", hint="run a spec first, or name the folder with --runs")
    command = [sys.executable, "-m", "tensorboard.main", "--logdir", str(runs), "--host", "localhost"]
    process = subprocess.Popen([*command, "--port", str(port)])
    try:
        code = process.wait()
    except KeyboardInterrupt:
        code = process.wait()  # it got the same signal
    raise typer.Exit(code if code >= 0 else 128 - code)
