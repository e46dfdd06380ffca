"""`karolos check`: whether specs are valid, without running them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from karolos.errors import KarolosError, Problem, SpecError, UsageError

from .arguments import Json, Runs
from .output import print_line, print_rows


def check(
    arguments: Annotated[
        list[str],
        typer.Argument(
            metavar="SPEC... [PATH=VALUE]...",
            help="YAML specs to check, and settings that replace those of every spec.",
        ),
    ],
    runs: Runs = Path("runs"),
    json: Json = False,
) -> None:
    """Check specs and print every problem as file:line:column: key: what is wrong.

    The parts of a valid spec are created once to see whether they fit together, and those of each variant of a
    transfer. Nothing is trained.
    Exit code 0: all specs are valid; 2: one is invalid; 3: one names a broken plugin.
    """
    from karolos.specification import load_spec

    worst = 0
    overrides = [argument for argument in arguments if _is_override(argument)]
    specs = [Path(argument) for argument in arguments if not _is_override(argument)]
    if not specs:
        raise UsageError(f"{' '.join(overrides)} is not a spec", hint="karolos check SPEC... [PATH=VALUE]...")
    for path in specs:
        found: Sequence[Problem | KarolosError] = ()
        note = None
        try:
            spec = load_spec(path, overrides)
            from karolos.training.assembly import check_parts  # not for an invalid spec: it takes half a second

            note = check_parts(spec)
            if getattr(spec.agent.settings, "start_from", None) is not None:
                from karolos.experiment.start_from import pinned

                pinned(spec, runs)
            if spec.transfer is not None:
                from karolos.transfer.matrix import Matrix

                Matrix(spec).check()
        except KarolosError as error:
            worst = max(worst, error.exit_code)
            found = error.problems if isinstance(error, SpecError) else (error,)
        if json:
            print_rows([_row(path, one) for one in found] or [_row(path, None, note)], json=True)
        elif not found:
            print_line(f"{path}: ok, but {note}" if note else f"{path}: ok")
        for one in () if json else found:
            print_line(str(one))
    raise typer.Exit(worst)


def _is_override(argument: str) -> bool:
    """Whether an argument sets something instead of naming a file."""
    return "=" in argument and not os.path.exists(argument)  # Path.exists raises for a long text


def _row(path: Path, found: Problem | KarolosError | None, note: str | None = None) -> dict[str, Any]:
    row = {"spec": str(path), "ok": found is None, "where": str(path), "key": "", "problem": None, "hint": note}
    if found is not None:
        where = None if found.where is None else str(found.where)
        row |= {"where": where, "key": found.setting or "", "problem": found.what, "hint": found.hint}
    return row
