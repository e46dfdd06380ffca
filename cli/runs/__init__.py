"""`karolos runs`: what was run, and with which results."""

from __future__ import annotations

import typer

from .archives import export_runs, import_runs
from .labels import note, tag
from .listing import list_runs
from .show import show
from .trash import remove, restore

app = typer.Typer(
    name="runs", help="List, show, label and remove runs; write them to an archive and read one.", no_args_is_help=True
)
app.command("list")(list_runs)
app.command()(show)
app.command()(tag)
app.command()(note)
app.command("rm")(remove)
app.command()(restore)
app.command("export")(export_runs)
app.command("import")(import_runs)
