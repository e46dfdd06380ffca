"""The `karolos` command: its subcommands, and its exit after errors."""

from __future__ import annotations

import errno
import gc
import os
import signal
import sys
import traceback
import warnings
from types import ModuleType
from typing import Annotated, Any

import typer
from typer.core import TyperGroup, TyperOption

from karolos import __version__, system
from karolos.errors import KarolosError, MachineError, PluginError
from karolos.experiment.interrupt import end_at_once

from . import db, inspect, plans, plugins, robot, runs, spec
from .check import check
from .compare import compare, diff
from .dataset import dataset
from .output import say
from .plans import suite, sweep, transfer
from .policy import export, play, zero_shot
from .run import resume, run
from .ui import board, ui

OBJECTS_PER_COLLECTION = 50_000
"""Number of new objects before Python collects garbage. With Python's default a short command spends an eighth of its
time on objects that imports make."""


class Commands(TyperGroup):
    """Commands whose help shows the values of each option. Interruptions and wrong calls are reported in one line."""

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        command = super().get_command(ctx, cmd_name)
        for option in command.get_params(ctx) if command else ():
            if isinstance(option, TyperOption) and option.metavar is None:
                if option.is_flag:
                    option.metavar = ""
                elif option.type_descriptor.is_ranged:
                    option.metavar = "INTEGER" if option.type_descriptor.ranged_type_name == "int" else "NUMBER"
        return command

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            error.message = error.message.removeprefix("Value error, ")  # of the library that reads the options
            raise
        except KeyboardInterrupt:  # of a second Ctrl-C, or of an environment; typer would print "Aborted!"
            say("interrupted")
            raise typer.Exit(128 + signal.SIGINT) from None


app = typer.Typer(
    name="karolos",
    cls=Commands,
    help="Run reinforcement-learning experiments on robots and tasks from YAML specs.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
)
for panel, parts in {
    "Train": (spec, check, run, resume, sweep, suite, transfer),
    "Look": (runs, plans, play, ui, board),  # `plans.app` is `karolos sweeps`
    "Compare": (compare, diff, zero_shot),
    "Extend": (plugins, inspect, robot),
    "Keep": (export, dataset, db),
}.items():
    for part in parts:
        if isinstance(part, ModuleType):
            app.add_typer(part.app, cls=Commands, rich_help_panel=panel)
        else:
            app.command("test" if part is zero_shot else None, rich_help_panel=panel)(part)


def _print_version(asked: bool) -> None:
    if asked:
        print(f"karolos {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def root(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Declarative reinforcement-learning experiments on robot-task environments."""


def main() -> None:
    """Run the command line. A KarolosError becomes a line on stderr and its exit code."""
    gc.set_threshold(OBJECTS_PER_COLLECTION)
    warnings.formatwarning = lambda message, *_arguments, **_more: f"{message}\n"  # a line, without karolos' source
    sys.stdout = sys.stdout or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115  (None if it is closed)
    sys.stderr = sys.stderr or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    system.use_utf8()
    try:
        os.getcwd()
    except FileNotFoundError:
        say("the current folder was removed (and perhaps made again); change into an existing one, e.g. cd .")
        sys.exit(MachineError.exit_code)
    sys.stderr = system.unfailing(sys.stderr)
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, end_at_once)  # runs handle it themselves
    try:
        try:
            app()
        finally:
            sys.stdout.flush()
    except KeyboardInterrupt:  # before a command is called
        say("interrupted")
        sys.exit(128 + signal.SIGINT)
    except OSError as error:
        if error.filename is not None or error.errno not in (
            errno.ENOSPC,
            errno.EDQUOT,
            errno.EIO,
            *system.CLOSED_PIPE,
        ):
            raise
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115  (what it could not print must not be tried again)
        say(f"standard output cannot be written: {error.strerror}")
        sys.exit(MachineError.exit_code)
    except KarolosError as error:
        if isinstance(error, PluginError) and error.__cause__ is not None:
            traceback.print_exception(error.__cause__)  # shows the plugin's author the place of the failure
        for line in str(error).splitlines():
            say(line)
        sys.exit(error.exit_code)
