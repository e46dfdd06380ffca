"""`karolos spec`: the specs that ship, what a spec resolves to, and the schema of specs."""

from __future__ import annotations

import json as json_text
import os
from pathlib import Path
from typing import Annotated

import typer

from karolos.errors import UsageError
from karolos.files import write_whole

from .arguments import Json, Overrides, SpecFile, check_file
from .completion import complete_spec
from .output import print_line, print_rows, warn

app = typer.Typer(
    name="spec",
    help="The specs that ship, what a spec resolves to, and the schema.",
    no_args_is_help=True,
)


@app.command("list")
def list_specs(json: Json = False) -> None:
    """List the specs that ship with karolos: `karolos run NAME` runs one, `extends: karolos:NAME` extends it."""
    from karolos.specification.files import shipped_specs

    rows = [
        {"name": name, "about": path.read_text("utf-8").partition("\n")[0].removeprefix("# ")}
        for name, path in shipped_specs().items()
    ]
    print_rows(sorted(rows, key=lambda row: row["name"].count("/")), json=json)


@app.command()
def copy(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Of a spec that ships.", autocompletion=complete_spec)],
    file: Annotated[Path | None, typer.Argument(metavar="[FILE]", help="The copy. Default: NAME.yaml here.")] = None,
) -> None:
    """Copy a spec that ships, to change it. What it extends stays in the package, as karolos:NAME."""
    from karolos.specification.files import shipped_text

    text = shipped_text(name)
    target = file or Path(f"{Path(name.removeprefix('karolos:')).stem}.yaml")
    if os.path.lexists(target):
        raise UsageError("exists already", where=str(target), hint="name another FILE")
    check_file(target)
    write_whole(target, text)
    print_line(str(target))


@app.command()
def show(
    spec: SpecFile,
    overrides: Overrides = None,
    origin: Annotated[bool, typer.Option("--origin", help="Show where each value comes from.")] = False,
    json: Json = False,
) -> None:
    """Print SPEC with everything that it extends and every default: YAML that is a valid spec itself.

    With --origin: one line per value with its file:line:column, override or default.
    """
    from karolos.report.tables import setting
    from karolos.specification import load_spec, to_yaml
    from karolos.specification.tree import leaves

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
