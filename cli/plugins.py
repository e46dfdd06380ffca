"""`karolos plugins`: what is installed, what can be set, and a package to begin one's own from."""

from __future__ import annotations

import json as json_text
import sys
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from karolos.errors import KarolosError, PluginError
from karolos.report.terminal import clean

from .common import Json, rows, table

if TYPE_CHECKING:
    from pydantic import BaseModel

    from karolos.plugins.contracts import Case

app = typer.Typer(
    name="plugins", help="List, show and check robots, tasks, agents, ..., or begin a new one.", no_args_is_help=True
)
Kind = Annotated[str, typer.Argument(metavar="KIND", help="robot, task, environment, agent, buffer, ...")]


@app.command("list")
def list_plugins(
    kind: Annotated[
        str | None, typer.Argument(metavar="[KIND]", help="Only this kind: robot, task, agent, ...", show_default=False)
    ] = None,
    json: Json = False,
) -> None:
    """List the installed plugins and the distributions that they come from. Imports none of them."""
    from karolos.registry import KINDS, entries, singular

    found = [entry for each in ([_kind(kind)] if kind else KINDS) for entry in entries(each)]
    rows(
        [
            {
                "kind": singular(entry.kind),
                "name": entry.name,
                "distribution": entry.distribution,
                "version": entry.version,
                "target": entry.target,
            }
            for entry in found
        ],
        json=json,
    )


@app.command()
def show(
    kind: Kind,
    name: Annotated[str, typer.Argument(metavar="NAME", help="The name that a spec uses.")],
    json: Json = False,
) -> None:
    """Show a plugin: what it is, and its settings with types, defaults and units."""
    import inspect

    from karolos.registry import find, load, singular

    entry = find(_kind(kind), name)
    plugin = load(entry.kind, name)
    settings = _settings(plugin.Settings)
    if json:
        rows(settings, json=True)
        return
    print(clean(f"{singular(entry.kind)} {name} ({entry.distribution} {entry.version}, {entry.target})"))
    for line in (inspect.getdoc(plugin) or "").splitlines():
        print(f"  {clean(line)}".rstrip())
    print()
    if not settings:
        print("no settings")
        return
    table([_cells(row) for row in settings], ["setting", "type", "default", "description"])


@app.command()
def new(
    kind: Annotated[
        str, typer.Argument(metavar="KIND", help="robot, task, agent, buffer, environment or distribution.")
    ],
    name: Annotated[str, typer.Argument(metavar="NAME", help="What specs will call it, e.g. my_arm.")],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder to write; karolos-NAME if not given.", show_default=False)
    ] = None,
) -> None:
    """Write a package with a plugin that works and is tested, to be changed into one's own. Prints its files."""
    from karolos.plugins.starter import write_starter

    for path in write_starter(kind, name, out or Path(f"karolos-{name.replace('_', '-')}")):
        print(clean(str(path)))


@app.command()
def check(
    kind: Kind,
    name: Annotated[str, typer.Argument(metavar="NAME", help="The name that a spec uses.")],
    settings: Annotated[
        list[str] | None,
        typer.Argument(metavar="[SETTING=VALUE]...", help="Settings other than its defaults.", show_default=False),
    ] = None,
    json: Json = False,
) -> None:
    """Check what plugins of that kind promise, as karolos's own tests do; exit code 3 if a promise is broken.

    A robot is checked with every installed task, a task with every installed robot, which takes a minute.
    """
    from karolos.plugins.contracts import candidate, cases
    from karolos.spec import parse_settings

    found = cases(candidate(_kind(kind), name, **parse_settings(settings or ())))
    broken = 0
    for case in found:
        problem = _problem(case)
        broken += problem is not None
        if json:
            rows([{"promise": str(case), "text": case.text, "kept": problem is None, "problem": problem}], json=True)
        else:
            print(clean(f"{'ok    ' if problem is None else 'BROKEN'} {case}"), flush=True)
            for line in () if problem is None else (case.text, problem):
                print(clean(f"       {line}"), flush=True)
    print(f"{len(found) - broken} of {len(found)} promises are kept", file=sys.stderr)
    if broken:
        raise typer.Exit(PluginError.exit_code)


def _problem(case: Case) -> str | None:
    """What is wrong, in one line; None where the promise is kept."""
    try:
        case()
    except AssertionError as error:
        return str(error)
    except KarolosError as error:
        return " ".join(str(error).splitlines())
    except Exception as error:  # a plugin's code may raise anything; its author needs to see where
        traceback.print_exception(error)
        return f"{type(error).__name__}: {' '.join(str(error).splitlines())}"
    return None


def _kind(text: str) -> str:
    """The kind, named in singular or plural. An unknown one is the registry's to refuse."""
    from karolos.registry import KINDS

    return f"{text}s" if f"{text}s" in KINDS else text


def _settings(model: type[BaseModel], prefix: str = "") -> list[dict[str, Any]]:
    """One row per setting; the settings of nested models follow their own, with dotted names."""
    from karolos.spec.problems import models_in

    schemas = model.model_json_schema()["properties"] if model.model_fields else {}
    found = []
    for name, field in model.model_fields.items():
        found.append(
            {
                "setting": f"{prefix}{name}",
                "type": _words(schemas.get(name, {})),
                "required": field.is_required(),
                "default": None if field.is_required() else _plain(field.get_default(call_default_factory=True)),
                "description": field.description or "",
            }
        )
        for nested in models_in(field.annotation):
            found.extend(_settings(nested, f"{prefix}{name}."))
    return found


def _plain(value: object) -> object:
    """A default as it would stand in a spec."""
    from pydantic_core import to_jsonable_python

    return to_jsonable_python(value)


def _cells(row: dict[str, Any]) -> list[str]:
    default = "required" if row["required"] else row["default"]
    text = default if isinstance(default, str) else json_text.dumps(default)
    return [row["setting"], row["type"], text, row["description"]]


_LIMITS = {
    "minimum": ">=",
    "exclusiveMinimum": ">",
    "maximum": "<=",
    "exclusiveMaximum": "<",
}


def _words(schema: dict[str, Any]) -> str:
    if "anyOf" in schema:
        return " or ".join(dict.fromkeys(_words(entry) for entry in schema["anyOf"]))
    if "enum" in schema:
        return " | ".join(map(str, schema["enum"]))
    if "const" in schema:
        return str(schema["const"])
    if "$ref" in schema:
        return "mapping"
    kind = {"object": "mapping", "array": "list"}.get(schema.get("type", ""), schema.get("type", "any"))
    if schema.get("type") == "array" and isinstance(schema.get("items"), dict):
        kind = f"list of {_words(schema['items'])}"
    limits = [f"{sign} {schema[limit]:g}" for limit, sign in _LIMITS.items() if limit in schema]
    return " ".join([kind, ", ".join(limits)]).strip()
