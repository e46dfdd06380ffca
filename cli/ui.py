"""`karolos ui`: the runs in a browser. `karolos board`: TensorBoard on the runs folder."""

from __future__ import annotations

import importlib.util
import signal
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer

from karolos.errors import MachineError, UsageError

from .arguments import Database, Runs, open_or_make_store
from .output import print_line, say


def ui(
    runs: Runs = Path("runs"),
    database: Database = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port on this machine. 0: any free port.")] = 6789,
    host: Annotated[
        str,
        typer.Option(metavar="ADDRESS", help="Name or address to listen on. Other machines need a token."),
    ] = "127.0.0.1",
    token: Annotated[
        str | None,
        typer.Option(
            metavar="TEXT",
            envvar="KAROLOS_TOKEN",
            help="Token that the page asks for. Default: none on this machine, a random one for other machines.",
        ),
    ] = None,
    open_browser: Annotated[bool, typer.Option("--open", help="Open the page in a browser.")] = False,
) -> None:
    """Show the runs in a browser, live while they train: curves, tests, films, comparisons. Ctrl-C ends it."""
    missing = [name for name in ("starlette", "uvicorn") if importlib.util.find_spec(name) is None]
    if missing:
        raise UsageError(f"{' and '.join(missing)} is missing", hint="pip install 'karolos[ui]'")
    from karolos.report.ui.server import serve

    def ready(address: str) -> None:
        say(f"shows {runs}; Ctrl-C ends it")
        print_line(address)
        if open_browser:
            import webbrowser

            webbrowser.open(address)

    with open_or_make_store(runs, database) as store:
        serve(runs, store, host=host, port=port, token=token, ready=ready)


def board(
    runs: Runs = Path("runs"),
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port on this machine. 0: any free port.")] = 6006,
) -> None:
    """Start TensorBoard on the runs folder. Ctrl-C ends it."""
    if not runs.is_dir():
        raise UsageError(f"there is no runs folder {runs}", hint="run a spec first, or name the folder with --runs")
    command = [sys.executable, "-m", "tensorboard.main", "--logdir", str(runs), "--host", "localhost"]
    process = subprocess.Popen([*command, "--port", str(port)])
    signal.signal(signal.SIGTERM, lambda *_: process.terminate())
    try:
        code = process.wait()
    except KeyboardInterrupt:
        code = process.wait()  # it got the same signal
    raise typer.Exit(128 - code if code < 0 else MachineError.exit_code if code else 0)
