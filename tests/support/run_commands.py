"""Calls of commands whose errors a test reads as exceptions."""

import json
from typing import Any

import typer
from typer.testing import CliRunner, Result

from karolos.errors import KarolosError


def call(app: typer.Typer, *arguments: object, exit_code: int = 0) -> Result:
    """Run a command; a KarolosError, which `karolos` prints as one line, is raised here."""
    ended = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if isinstance(ended.exception, KarolosError):
        raise ended.exception
    if ended.exception is not None and not isinstance(ended.exception, SystemExit):
        raise ended.exception
    assert ended.exit_code == exit_code, ended.output
    return ended


def rows(app: typer.Typer, *arguments: object) -> list[dict[str, Any]]:
    return [json.loads(line) for line in call(app, *arguments, "--json").stdout.splitlines()]
