"""`karolos check`: checks specs without running them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from karolos.errors import KarolosError, Problem, SpecError, UsageError

from .arguments import Json, Runs
from .completion import complete_spec
from .output import print_line, print_rows

if TYPE_CHECKING:
    from karolos.specification import Spec


def check(
    arguments: Annotated[
        list[str],
        typer.Argument(
            metavar="SPEC... [PATH=VALUE]...",
            help="YAML files to check, and settings to change in each of them.",
            autocompletion=complete_spec,
        ),
    ],
    runs: Runs = Path("runs"),
    json: Json = False,
) -> None:
    """Check specs and suites, and print every problem as file:line:column: key: what is wrong.

    The parts of a valid spec are built once, and the environment makes its first steps. This shows whether the parts
    fit together. A transfer is checked with all its variants, a suite with all its specs. Nothing is trained.
    Exit code 0: all specs are valid; 2: a spec is invalid; 3: a plugin is broken, or a library is missing.
    """
    from karolos.specification import load_spec
    from karolos.specification.suite import is_suite, load_suite

    worst = 0
    overrides = [argument for argument in arguments if _is_override(argument)]
    paths = [Path(argument) for argument in arguments if not _is_override(argument)]
    if not paths:
        raise UsageError(f"{' '.join(overrides)} is not a spec", hint="karolos check SPEC... [PATH=VALUE]...")
    for path in paths:
        found: Sequence[Problem | KarolosError] = ()
        note = None
        try:
            specs: Sequence[Spec] = () if is_suite(path) else [load_spec(path, overrides)]
            if not specs:
                suite = load_suite(path, overrides)
                from karolos.plans.suite import fitted  # not for an invalid one, as below

                suite = fitted(suite)
                specs, found = suite.specs, tuple(suite.refused.values())
                worst = max([worst, *(error.exit_code for error in suite.refused.values())])
            note = "; ".join(dict.fromkeys(filter(None, (_check_parts(spec, runs) for spec in specs)))) or None
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


def _check_parts(spec: Spec, runs: Path) -> str | None:
    """Raise an error if the spec cannot work; returns a note on possible surprises."""
    from karolos.experiment.check import check_parts  # not for an invalid spec: it takes half a second

    note = check_parts(spec)
    if getattr(spec.agent.settings, "start_from", None) is not None:
        from karolos.experiment.start_from import pinned

        pinned(spec, runs)
    if spec.transfer is not None:
        from karolos.plans.matrix import Matrix

        Matrix(spec).check()
    return note


def _is_override(argument: str) -> bool:
    """Whether an argument is a setting and not a file."""
    return "=" in argument and not os.path.exists(argument)  # Path.exists raises for a long text


def _row(path: Path, found: Problem | KarolosError | None, note: str | None = None) -> dict[str, Any]:
    row = {"spec": str(path), "ok": found is None, "where": str(path), "key": "", "problem": None, "hint": note}
    if found is not None:
        where = None if found.where is None else str(found.where)
        row |= {"where": where, "key": found.setting or "", "problem": found.what, "hint": found.hint}
    return row
