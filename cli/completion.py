"""Completion by Tab: specs, runs, plugins, overrides, sweeps and tags, from the names of files."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Callable, Iterable
from pathlib import Path

import typer

import karolos
from karolos.system.files import SPECS

PACKAGE = Path(karolos.__file__).parent
PARTS = ("robot", "task", "environment", "agent", "buffer", "orchestrator", "launcher")


def complete_spec(incomplete: str) -> list[str]:
    """Shipped specs, and YAML files here and one folder below."""
    shipped = (path.relative_to(SPECS).with_suffix("").as_posix() for path in SPECS.glob("**/*.yaml"))
    start = glob.escape(incomplete)
    files = (name for deep in ("*", "*/*") for end in ("yaml", "yml") for name in glob.glob(f"{start}{deep}.{end}"))
    return _beginning(incomplete, [*shipped, *files])


def complete_run(ctx: typer.Context, incomplete: str) -> list[str]:
    """Runs, and the names of their experiments."""
    ids = [path.parent.name for path in _runs(ctx).glob("*/run.json")]
    return _beginning(incomplete, [*ids, *(re.sub(r"-s\d+-\d{8}-\d{6}(-\d+)?$", "", one) for one in ids), "@last"])


def complete_policy(ctx: typer.Context, incomplete: str) -> list[str]:
    """Runs and shipped policies."""
    shipped = [path.parent.name for path in PACKAGE.glob("records/shipped_runs/*/policy.npz")]
    return sorted({*complete_run(ctx, incomplete), *_beginning(incomplete, shipped)})


def complete_policy_or_spec(ctx: typer.Context, incomplete: str) -> list[str]:
    """Runs and policies; specs with --expert."""
    return complete_spec(incomplete) if ctx.params.get("expert") else complete_policy(ctx, incomplete)


def complete_folder(pattern: str) -> Callable[[typer.Context, str], list[str]]:
    """A completion of the folders of files in the runs folder, such as its sweeps."""
    return lambda ctx, incomplete: _beginning(incomplete, (path.parent.name for path in _runs(ctx).glob(pattern)))


def complete_tag(ctx: typer.Context, incomplete: str) -> list[str]:
    """Tags that runs have."""
    from karolos.records import labels

    found = (labels.read(path.parent).tags for path in _runs(ctx).glob("*/labels.json"))
    return _beginning(incomplete, (tag for tags in found for tag in tags))


def complete_override(ctx: typer.Context, incomplete: str) -> list[str]:
    """Parts of a spec with the plugins for them. bash gives `agent=s` as three words."""
    before = [word for word in ctx.params.get("overrides") or () if word != "="]
    if before and before[-1] in PARTS:
        return complete_plugin(f"{before[-1]}s")(incomplete)
    return _beginning(incomplete, (f"{key}={name}" for key in PARTS for name in complete_plugin(f"{key}s")("")))


def complete_plugin(kind: str) -> Callable[[str], list[str]]:
    """A completion of the plugins of a kind."""

    def complete(incomplete: str) -> list[str]:
        from karolos.registry import names

        return _beginning(incomplete, names(kind))

    return complete


def complete_plugin_of_kind(ctx: typer.Context, incomplete: str) -> list[str]:
    """The plugins of the kind in the argument before."""
    kind = f"{str(ctx.params.get('kind')).removesuffix('s')}s"
    return complete_plugin(kind)(incomplete) if kind.removesuffix("s") in complete_kind("") else []


def complete_kind(incomplete: str) -> list[str]:
    """Kinds of plugins."""
    from karolos.registry import KINDS, singular

    return _beginning(incomplete, map(singular, KINDS))


def _beginning(incomplete: str, names: Iterable[str]) -> list[str]:
    return sorted({name for name in names if name.startswith(incomplete)})


def _runs(ctx: typer.Context) -> Path:
    return Path(ctx.params.get("runs") or os.environ.get("KAROLOS_RUNS") or "runs")
