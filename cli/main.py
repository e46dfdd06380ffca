"""The `karolos` command: its subcommands, and how errors end it."""

from __future__ import annotations

import sys

import typer

from karolos.errors import KarolosError

app = typer.Typer(name="karolos", no_args_is_help=True, add_completion=True, pretty_exceptions_enable=False)


def main() -> None:
    """Run the command line; a KarolosError is one line on stderr and its exit code."""
    try:
        app()
    except KarolosError as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)
