"""`python -m bench NAME [--json]`: the speed of the parts on this machine, next to a peer measured in the same run.

The options of a benchmark are the parameters of its function `measure`, which yields rows.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from functools import wraps
from importlib import import_module
from typing import TYPE_CHECKING, Any, TextIO

import typer

from karolos.errors import KarolosError

if TYPE_CHECKING:
    from .side_by_side import Row

BENCHMARKS = ("updates", "buffers", "environment", "experts", "orchestrator", "store", "vector", "peer", "panda_gym")


def main(arguments: Sequence[str]) -> None:
    """Measure, and print the rows. Raises UsageError for an unknown part, MachineError where a peer is missing."""
    if not arguments or arguments[0] not in BENCHMARKS:
        sys.exit(f"usage: python -m bench {'|'.join(BENCHMARKS)} [--json] [OPTION]... (--help shows the options)")
    name, *options = arguments
    app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    measure = import_module(f"bench.{name}").measure
    about = (measure.__doc__ or "").replace("    Args:", "    \b\n    Args:")  # \b: lines stay as they are
    app.command(help=about)(_printed(name, measure, as_json="--json" in options))
    app([option for option in options if option != "--json"], prog_name=f"python -m bench {name}")


def _printed(name: str, measure: Callable[..., Iterable[Row]], *, as_json: bool) -> Callable[..., None]:
    """A command that prints a table, or a JSON object per row as soon as it is measured."""

    @wraps(measure)
    def command(**options: Any) -> None:
        with _only_rows() as out:
            rows = []
            for row in measure(**options):
                rows.append({"benchmark": name, **row.dump()})
                if as_json:
                    print(json.dumps(rows[-1]), file=out, flush=True)
        if not as_json:
            cells = [
                list(rows[0]),
                *(
                    [f"{value:.4g}" if isinstance(value, float) else str(value) for value in row.values()]
                    for row in rows
                ),
            ]
            widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
            for line in cells:
                print("  ".join(map(str.ljust, line, widths)).rstrip())

    return command


@contextmanager
def _only_rows() -> Iterator[TextIO]:
    """Standard output for rows alone. What libraries print there goes to stderr: pybullet prints a line at import."""
    sys.stdout.flush()
    real = os.dup(1)
    os.dup2(2, 1)
    try:
        with os.fdopen(os.dup(real), "w") as out, redirect_stdout(sys.stderr):
            yield out
    finally:
        os.dup2(real, 1)
        os.close(real)


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except KarolosError as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)
