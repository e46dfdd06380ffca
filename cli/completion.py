"""Shell completion of run ids, plugins and settings.

Settings are read from the source of plugins, because importing an agent takes seconds.
"""

from __future__ import annotations

import ast
import os
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from importlib.util import find_spec, resolve_name
from pathlib import Path

import typer

from karolos.errors import KarolosError


def complete_run(ctx: typer.Context, incomplete: str) -> list[str]:
    """@last, names of experiments and ids of runs."""
    runs = Path(ctx.params.get("runs") or os.environ.get("KAROLOS_RUNS") or "runs")
    ids = sorted(path.parent.name for path in runs.glob("*/run.json"))
    names = dict.fromkeys(name.rpartition("-s")[0] for name in ids)  # <name>-s<seed>-<time>
    return [text for text in ("@last", *names, *ids) if text.startswith(incomplete)]


def complete_kind(incomplete: str) -> list[str]:
    """Kinds of plugins, in singular."""
    from karolos.registry import KINDS, singular

    return [name for kind in KINDS if (name := singular(kind)).startswith(incomplete)]


def complete_plugin(kind: str | None = None) -> Callable[[typer.Context, str], list[str]]:
    """Completes the names of a kind of plugins; without a kind of that in the argument KIND."""

    def complete(ctx: typer.Context, incomplete: str) -> list[str]:
        from karolos.registry import names, singular

        wanted = singular(kind or str(ctx.params.get("kind")))
        with suppress(KarolosError):
            return [name for name in names(f"{wanted}s") if name.startswith(incomplete)]
        return []

    return complete


def complete_setting(ctx: typer.Context, incomplete: str) -> list[str]:
    """PATH= for each setting of a spec and of the plugins that the spec names."""
    from karolos.spec.files import SpecFiles, named_plugins

    found = list(_fields("karolos.spec.model:Spec"))
    with suppress(KarolosError):
        for key, plugin in named_plugins(SpecFiles(Path(str(ctx.params.get("spec")))).load()).items():
            found += [f"{key}.{field}" for field in _fields(f"{plugin.target}.Settings")]
    return [f"{path}=" for path in found if path.startswith(incomplete)]


def _fields(target: str) -> Iterator[str]:
    """The fields of the pydantic model `module:Class`, and those of nested models with dotted names."""
    found = _class(*target.split(":"))
    return iter(()) if found is None else _fields_of(*found)


def _fields_of(module: str, model: ast.ClassDef) -> Iterator[str]:
    for base in model.bases:
        yield from _fields(f"{module}:{ast.unparse(base)}")
    for line in model.body:
        if not isinstance(line, ast.AnnAssign) or not isinstance(line.target, ast.Name):
            continue
        name, annotation = line.target.id, ast.unparse(line.annotation)
        if not name.startswith("_") and not annotation.startswith("ClassVar"):
            yield name
            for nested in re.findall(r"[A-Za-z_.]+", annotation):
                yield from (f"{name}.{field}" for field in _fields(f"{module}:{nested}"))


def _class(module: str, name: str) -> tuple[str, ast.ClassDef] | None:
    """The module and the source of the class that a dotted name means in a module. Follows imports and base classes."""
    head, _, rest = name.partition(".")
    source, package = _source(module)
    for line in source:
        if isinstance(line, ast.ClassDef) and line.name == head:
            return _inner(module, line, rest)
        if isinstance(line, ast.ImportFrom):
            for alias in line.names:
                if (alias.asname or alias.name) == head:
                    origin = resolve_name("." * line.level + (line.module or ""), package)
                    return _class(origin, f"{alias.name}.{rest}".rstrip("."))
    return None


def _inner(module: str, owner: ast.ClassDef, name: str) -> tuple[str, ast.ClassDef] | None:
    """The class `name` within a class or its base classes; the class itself for an empty name."""
    if not name:
        return module, owner
    head, _, rest = name.partition(".")
    for line in owner.body:
        if isinstance(line, ast.ClassDef) and line.name == head:
            return _inner(module, line, rest)
    for base in owner.bases:
        above = _class(module, ast.unparse(base))
        if above is not None and (found := _inner(*above, name)):
            return found
    return None


@cache
def _source(module: str) -> tuple[list[ast.stmt], str]:
    """The statements of a module and its package; nothing for a module without source."""
    with suppress(ImportError, ValueError, OSError, SyntaxError):
        spec = find_spec(module)
        if spec is not None and spec.origin is not None and spec.origin.endswith(".py"):
            return ast.parse(Path(spec.origin).read_bytes()).body, spec.parent or ""
    return [], ""
