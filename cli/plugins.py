"""`karolos plugins`: installed plugins, their settings, and starter packages."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from karolos.errors import PluginError
from karolos.report.tables import Columns, Table, setting

from .arguments import Json
from .completion import complete_kind, complete_plugin, complete_plugin_of_kind
from .output import print_line, print_rows, print_table, say, warn

if TYPE_CHECKING:
    from pydantic import BaseModel


app = typer.Typer(
    name="plugins",
    help="List, show, check and create plugins: robots, grippers, tasks, agents and others.",
    no_args_is_help=True,
)
Kind = Annotated[
    str,
    typer.Argument(metavar="KIND", help="robot, task, environment, agent, buffer, ...", autocompletion=complete_kind),
]
Name = Annotated[
    str,
    typer.Argument(metavar="NAME", help="The name that a spec uses.", autocompletion=complete_plugin_of_kind),
]


@app.command("list")
def list_plugins(
    kind: Annotated[
        str | None,
        typer.Argument(metavar="[KIND]", help="Only this kind: robot, ...", autocompletion=complete_kind),
    ] = None,
    json: Json = False,
) -> None:
    """List the installed plugins and their distributions. No plugin is imported."""
    from karolos.records.provenance import sources
    from karolos.registry import KINDS, entries, singular, unreadable

    unread = list(unreadable())
    sources(unread=unread)
    for problem in unread:
        warn(f"{problem}; it is ignored")
    fields = ("name", "distribution", "version", "target")
    rows = [
        {"kind": singular(entry.kind), **{field: getattr(entry, field) for field in fields}}
        for each in ([_kind(kind)] if kind else KINDS)
        for entry in entries(each)
    ]
    print_rows(rows, json=json)


@app.command()
def show(
    kind: Kind,
    name: Name,
    json: Json = False,
) -> None:
    """Show a plugin: its documentation, and its settings with types, defaults and units."""
    import inspect

    from karolos.registry import find, load, singular

    entry = find(_kind(kind), name)
    plugin = load(entry.kind, name)
    settings = _settings(plugin.Settings)
    if json:
        print_rows(settings, json=True)
        return
    print_line(f"{singular(entry.kind)} {name} ({entry.distribution} {entry.version}, {entry.target})")
    for line in (inspect.getdoc(plugin) or "").splitlines():
        print_line(f"  {line}".rstrip())
    print()
    if not settings:
        print("no settings")
        return
    columns: Columns[dict[str, Any]] = {
        "setting": lambda row: row["setting"],
        "type": lambda row: row["type"],
        "default": lambda row: "required" if row["required"] else setting(row["default"]),
        "description": lambda row: row["description"],
    }
    print_table(Table.of(settings, columns))


@app.command()
def new(
    kind: Annotated[
        str,
        typer.Argument(
            metavar="KIND", help="robot, gripper, task, agent, buffer, environment, distribution or driver."
        ),
    ],
    name: Annotated[str, typer.Argument(metavar="NAME", help="Its name in specs, e.g. my_arm.")],
    out: Annotated[Path | None, typer.Option(metavar="FOLDER", help="Folder to write. Default: karolos-NAME.")] = None,
    urdf: Annotated[Path | None, typer.Option(metavar="FILE", help="URDF of the robot or gripper to write.")] = None,
    tool: Annotated[
        str | None, typer.Option(metavar="LINK", help="Link of the URDF that is the tool frame, with z forwards.")
    ] = None,
    gripper: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Gripper that replaces the hand in a robot's URDF.",
            autocompletion=complete_plugin("grippers"),
        ),
    ] = None,
) -> None:
    """Write a package with a working, tested plugin. Prints its files, and the assumptions about a URDF."""
    from karolos.plugins.starter import write_starter

    folder = out or Path(f"karolos-{name.replace('_', '-')}")
    files, notes = write_starter(kind, name, folder, urdf=urdf, tool=tool, gripper=gripper)
    for path in files:
        print_line(str(path))
    for note in notes:
        say(f"assumed: {note}")


@app.command()
def check(
    kind: Kind,
    name: Name,
    settings: Annotated[
        list[str] | None, typer.Argument(metavar="[SETTING=VALUE]...", help="Settings that differ from the defaults.")
    ] = None,
    engine: Annotated[
        Literal["mujoco", "bullet"] | None,
        typer.Option(help="Physics engine of a robot or a task. Default: mujoco."),
    ] = None,
    json: Json = False,
) -> None:
    """Check a plugin's contract, as karolos's own tests do. Exit code 3 if the plugin breaks a promise.

    A robot is checked with every installed task, a task with every installed robot, and a gripper on every arm that
    has a flange. This takes a minute.
    """
    from karolos.plugins.contracts import candidate, cases, results
    from karolos.specification import parse_settings

    found = cases(candidate(_kind(kind), name, engine, **parse_settings(settings or ())))
    checked, broken = 0, 0
    problems: dict[str, str] = {}
    for case, problem in results(found):
        checked += 1
        broken += problem is not None
        if json:
            row = {"promise": str(case), "text": case.text, "kept": problem is None, "problem": problem}
            print_rows([row], json=True)
        elif problem is None:
            print_line(f"ok     {case}")
        else:
            print_line(f"BROKEN {case}")
            first = problems.setdefault(problem, str(case))
            for line in (case.text, problem if first == str(case) else f"the same problem as of {first}"):
                print_line(f"       {line}")
    say(f"{checked - broken} of {len(found)} promises are kept")
    if checked < len(found):
        say(f"{len(found) - checked} were not checked: they need the broken one")
    if broken:
        raise typer.Exit(PluginError.exit_code)


def _kind(text: str) -> str:
    """The kind in plural, from singular or plural. The registry refuses an unknown one."""
    from karolos.registry import KINDS

    return f"{text}s" if f"{text}s" in KINDS else text


def _settings(model: type[BaseModel], prefix: str = "") -> list[dict[str, Any]]:
    """One row per setting. The settings of a nested model follow with dotted names."""
    from pydantic_core import to_jsonable_python

    from karolos.specification.bind import models_in

    schemas = model.model_json_schema()["properties"] if model.model_fields else {}
    found = []
    for name, field in model.model_fields.items():
        required = field.is_required()
        row = {
            "setting": f"{prefix}{name}",
            "type": _type_text(schemas.get(name, {})),
            "required": required,
            "default": None if required else to_jsonable_python(field.get_default(call_default_factory=True)),
            "description": field.description or "",
        }
        found.append(row)
        for nested in models_in(field.annotation):
            found.extend(_settings(nested, f"{prefix}{name}."))
    return found


_LIMITS = {"minimum": ">=", "exclusiveMinimum": ">", "maximum": "<=", "exclusiveMaximum": "<"}


def _type_text(schema: dict[str, Any]) -> str:
    if "anyOf" in schema:
        return " or ".join(dict.fromkeys(_type_text(entry) for entry in schema["anyOf"]))
    if "enum" in schema:
        return " | ".join(map(str, schema["enum"]))
    if "const" in schema:
        return str(schema["const"])
    if "$ref" in schema:
        return "mapping"
    kind = {"object": "mapping", "array": "list"}.get(schema.get("type", ""), schema.get("type", "any"))
    if schema.get("type") == "array" and isinstance(schema.get("items"), dict):
        kind = f"list of {_type_text(schema['items'])}"
    limits = [f"{sign} {schema[limit]:g}" for limit, sign in _LIMITS.items() if limit in schema]
    return " ".join([kind, ", ".join(limits)]).strip()
