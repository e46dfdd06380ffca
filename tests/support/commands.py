"""Runs a command in this process as the command line does."""

import io
import re

import typer
from typer.testing import CliRunner

from karolos.errors import KarolosError


def call(app: typer.Typer, *arguments: str) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command; a KarolosError ends it as in karolos_cli.main."""
    result = CliRunner().invoke(app, arguments)
    if isinstance(result.exception, KarolosError):
        return result.exception.exit_code, result.stdout, f"{result.stderr}{result.exception}\n"
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr


class Terminal(io.StringIO):
    """A screen."""

    def isatty(self) -> bool:
        return True

    def text(self) -> str:
        """What was written, without colours and movements of the cursor."""
        return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", self.getvalue())
