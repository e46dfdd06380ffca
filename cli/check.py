"""`karolos check`: whether specs are valid, without running them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

import typer

from .arguments import Json
from .output import print_line, print_rows


def check(
    arguments: Annotated[
        list[str],
        typer.Argument(
            metavar="SPEC... [PATH=VALUE]...",
            help="YAML specs to check, and settings that replace those of every spec.",
        ),
    ],
    json: Json = False,
) -> None:
    """Check specs and print every problem as file:line:column: key: what is wrong.

    The parts of a valid spec are created once to see whether they fit together, and those of each variant of a
    transfer. Nothing is trained.
    Exit code 0: all specs are valid; 2: one is invalid; 3: one names a broken plugin.
    """
    from karolos.errors import KarolosError, SpecError, UsageError
    from karolos.specification import load_spec

    worst = 0
    overrides = [argument for argument in arguments if _is_override(argument)]
    specs = [Path(argument) for argument in arguments if not _is_override(argument)]
    if not specs:
        raise UsageError(f"{' '.join(overrides)} is not a spec", hint="karolos check SPEC... [PATH=VALUE]...")
    for path in specs:
        found: list[dict[str, Any]] = []
        note = None
        try:
            spec = load_spec(path, overrides)
            from karolos.training.assembly import check_parts  # not for an invalid spec: it takes half a second

            note = check_parts(spec)
            if spec.transfer is not None:
                from karolos.transfer.matrix import Matrix

                Matrix(spec).check()
        except SpecError as error:
            worst = max(worst, error.exit_code)
            found = [_row(path, str(one.where), one.setting, one.what, one.hint) for one in error.problems]
        except KarolosError as error:
            worst = max(worst, error.exit_code)
            found = [_row(path, error.where, error.setting or "", error.what, error.hint)]
        if json:
            print_rows(found or [_row(path, str(path), "", None, note)], json=True)
            continue
        if not found:
            print_line(f"{path}: ok, but {note}" if note else f"{path}: ok")
        for row in found:
            line = ": ".join(part for part in (row["where"], row["key"], row["problem"]) if part)
            print_line(f"{line}; {row['hint']}" if row["hint"] else line)
    raise typer.Exit(worst)


def _is_override(argument: str) -> bool:
    """Whether an argument sets something instead of naming a file."""
    return "=" in argument and not os.path.exists(argument)  # Path.exists raises for a long text


def _row(path: Path, where: str | None, key: str, what: str | None, hint: str | None) -> dict[str, Any]:
    return {"spec": str(path), "ok": what is None, "where": where, "key": key, "problem": what, "hint": hint}
