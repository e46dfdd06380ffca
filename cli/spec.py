"""`karolos spec`: lists and copies shipped specs, resolves a spec, prints the schema of specs."""

from __future__ import annotations

import json as json_text
import os
from pathlib import Path
from typing import Annotated

import typer

from karolos.errors import UsageError
from karolos.system.files import write_whole

from .arguments import Json, Overrides, SpecFile, check_file
from .completion import complete_spec
from .output import print_line, print_rows, warn

app = typer.Typer(
    name="spec",
    help="List, copy and show specs; print their JSON Schema.",
    no_args_is_help=True,
)


@app.command("list")
def list_specs(json: Json = False) -> None:
    """List the shipped specs. `karolos run NAME` runs one, `extends: karolos:NAME` extends it."""
    from karolos.specification.files import shipped_specs

    rows = [
        {"name": name, "about": path.read_text("utf-8").partition("\n")[0].removeprefix("# ")}
        for name, path in shipped_specs().items()
    ]
    print_rows(sorted(rows, key=lambda row: row["name"].count("/")), json=json)


@app.command()
def copy(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of a shipped spec.", autocompletion=complete_spec)],
    file: Annotated[Path | None, typer.Argument(metavar="[FILE]", help="File to write. Default: NAME.yaml.")] = None,
) -> None:
    """Copy a shipped spec so that you can change it. The specs that it extends stay in the package, as karolos:NAME."""
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
    """Print SPEC with every extended setting and default. The output is a valid spec.

    With --origin: one line per value, with the file:line:column, override or default that it comes from.
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
