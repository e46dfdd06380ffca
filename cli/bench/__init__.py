"""`karolos bench`: how fast the parts are on this machine, beside a peer measured in the same run."""

from __future__ import annotations

import typer

from .agents import agents
from .buffers import buffers
from .environment import environment
from .experts import experts
from .orchestrator import orchestrator
from .store import store
from .survival import survival
from .training import training
from .updates import updates

app = typer.Typer(name="bench", help="Measure the speed of parts beside a peer in the same run.", no_args_is_help=True)
app.command()(agents)
app.command()(buffers)
app.command()(environment)
app.command()(orchestrator)
app.command()(experts)
app.command()(store)
app.command()(survival)
app.command()(training)
app.command()(updates)
