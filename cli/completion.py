"""Shell completion of run ids, plugins and settings."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from karolos.errors import KarolosError

if TYPE_CHECKING:
    from pydantic import BaseModel


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
    """PATH= for each setting of a spec and of the plugin whose key is typed, which is imported."""
    from karolos.registry import load
    from karolos.specification.files import SpecFiles, named_plugins
    from karolos.specification.model import Spec

    found = list(_settings(Spec))
    with suppress(KarolosError):
        for key, plugin in named_plugins(SpecFiles(Path(str(ctx.params.get("spec")))).load()).items():
            if incomplete and key.startswith(incomplete.partition(".")[0]):
                found += [f"{key}.{path}" for path in _settings(load(plugin.kind, plugin.name).Settings)]
    return [f"{path}=" for path in found if path.startswith(incomplete)]


def _settings(model: type[BaseModel]) -> Iterator[str]:
    """The fields of a model, and those of nested models with dotted names."""
    from karolos.specification.problems import models_in

    for name, field in model.model_fields.items():
        yield name
        for nested in models_in(field.annotation):
            yield from (f"{name}.{path}" for path in _settings(nested))
