"""karolos bench: how fast the parts are on this machine, beside a peer measured in the same run. One file a command."""

from __future__ import annotations

import typer

from .environment import environment

app = typer.Typer(help="Measure the speed of parts, beside a peer in the same run.", no_args_is_help=True)
app.command()(environment)


@app.callback()
def bench() -> None:
    """Measure the speed of parts, beside a peer in the same run."""
