"""Shell completion of run ids and plugins."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
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
