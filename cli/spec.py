"""`karolos spec`: what a spec resolves to, and the schema of specs."""

from __future__ import annotations

import json as json_text
from pathlib import Path
from typing import Annotated

import typer

from .arguments import Json, Overrides
from .output import print_line, print_rows, warn

app = typer.Typer(name="spec", help="Show what a spec resolves to, and the schema of specs.", no_args_is_help=True)


@app.command()
def show(
    spec: Annotated[Path, typer.Argument(metavar="SPEC", help="The YAML spec.")],
    overrides: Overrides = None,
    origin: Annotated[bool, typer.Option("--origin", help="Show where each value comes from.")] = False,
    json: Json = False,
) -> None:
    """Print SPEC with everything that it extends and every default: YAML that is a valid spec itself.

    With --origin: one line per value with its file:line:column, override or default.
    """
    from karolos.report.tables import setting
    from karolos.specification import load_spec, to_yaml
    from karolos.specification.nodes import leaves

    found = load_spec(spec, overrides or ())
    if not (origin or json):
        print(to_yaml(found.dump()), end="")
        return
    origins = found.origins
    values = {".".join(path): value for path, value in leaves(found.dump())}
    if json:
        rows = [{"path": path, "value": value, "origin": origins[path]} for path, value in values.items()]
        print_rows(rows, json=True)
        return
    lines = {path: f"{path} = {setting(value)}" for path, value in values.items()}
    width = min(max(map(len, lines.values())), 60)
    for path, line in lines.items():
        print_line(f"{line:<{width}}  # {origins[path]}")


@app.command()
def schema() -> None:
    """Print the JSON Schema of specs for editors, with the settings of every installed plugin."""
    from karolos.specification.schema import spec_schema

    found, broken = spec_schema()
    for error in broken:
        warn(f"left out: {error}")
    print(json_text.dumps(found, indent=2))
