"""`karolos spec`: what a spec resolves to, and what may stand in one."""

from __future__ import annotations

import json as json_text
import sys
from pathlib import Path
from typing import Annotated

import typer

from karolos.report.terminal import clean

from .common import Json, Overrides, rows

app = typer.Typer(name="spec", help="Show what a spec resolves to, and the schema of specs.", no_args_is_help=True)


@app.command()
def show(
    spec: Annotated[Path, typer.Argument(help="The YAML spec.", show_default=False)],
    overrides: Overrides = None,
    origin: Annotated[bool, typer.Option("--origin", help="Say of each value where it comes from.")] = False,
    json: Json = False,
) -> None:
    """Print SPEC with everything it extends and every default filled in: YAML that is a spec itself.

    With --origin: one line per value with the file:line:column, override or default that it comes from.
    """
    from karolos.spec import load_spec, to_yaml
    from karolos.spec.nodes import leaves

    found = load_spec(spec, overrides or ())
    if not (origin or json):
        print(to_yaml(found.dump()), end="")
        return
    origins = found.origins
    values = {".".join(path): value for path, value in leaves(found.dump())}
    if json:
        rows([{"path": path, "value": value, "origin": origins[path]} for path, value in values.items()], json=True)
        return
    lines = {path: f"{path} = {_inline(value)}" for path, value in values.items()}
    width = min(max(map(len, lines.values())), 60)
    for path, line in lines.items():
        print(clean(f"{line:<{width}}  # {origins[path]}"))


@app.command()
def schema() -> None:
    """Print the JSON Schema of specs, with the settings of every installed plugin, for editors to use."""
    from karolos.spec.schema import spec_schema

    found, broken = spec_schema()
    for error in broken:
        print(clean(f"warning: left out: {error}"), file=sys.stderr)
    print(json_text.dumps(found, indent=2))


def _inline(value: object) -> str:
    return value if isinstance(value, str) else json_text.dumps(value)
