"""Runs commands in this process as the command line does."""

import io
import json
import re
from typing import Any, NamedTuple

import typer
from karolos_cli.main import app as everything
from typer.testing import CliRunner

from karolos.errors import KarolosError


class Ended(NamedTuple):
    """Exit code, stdout and stderr of a command."""

    code: int
    out: str
    err: str


def call(app: typer.Typer, *arguments: object) -> Ended:
    """Run a command; a KarolosError ends it as in karolos_cli.main."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if isinstance(result.exception, KarolosError):
        return Ended(result.exception.exit_code, result.stdout, f"{result.stderr}{result.exception}\n")
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return Ended(result.exit_code, result.stdout, result.stderr)


def karolos(*words: object, code: int = 0) -> Ended:
    """Run `karolos` with these words, and require this exit code."""
    ended = call(everything, *words)
    assert ended.code == code, ended
    return ended


def rows(*words: object, code: int = 0) -> list[dict[str, Any]]:
    """What `karolos` prints with --json."""
    return [json.loads(line) for line in karolos(*words, "--json", code=code).out.splitlines()]


def refused(*words: object, code: int = 2) -> str:
    """What `karolos` says instead of printing anything."""
    ended = karolos(*words, code=code)
    assert ended.out == ""
    return ended.err


class Terminal(io.StringIO):
    """A screen."""

    def isatty(self) -> bool:
        return True

    def text(self) -> str:
        """What was written, without colours and movements of the cursor."""
        return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", self.getvalue())
