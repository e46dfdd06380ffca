"""Going on with a run that ended too soon: which one, and from where."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .. import checkpoint
from ..checkpoint import CheckpointError
from ..core import State
from ..errors import RunError
from ..records import RunFolder, scan

LAST, BEFORE = "last", "previous"
"""The newest checkpoint that a run can go on from, and the one before it, for when the newest is damaged."""
PARTS = ("agent", "buffer", "training", "run")
"""What such a checkpoint holds."""


@dataclass(frozen=True)
class Snapshot:
    """Where a run goes on."""

    parts: dict[str, State]
    meta: dict[str, Any]
    """Of the checkpoint: experiment, seed, steps, updates, seconds, episodes_bytes."""
    warnings: tuple[str, ...] = ()
    """Which checkpoints could not be used, and why."""


def newest_snapshot(folder: RunFolder) -> Snapshot:
    """The newest sound checkpoint of the run that it can go on from; from the beginning where there is none.

    Raises:
        RunError: the checkpoint is of another experiment, or of a newer karolos; or there are some and none is sound.
    """
    warnings: list[str] = []
    there = checkpoint.names(folder.checkpoints)
    for name in (LAST, BEFORE):
        if name not in there:
            continue
        try:
            parts, meta = checkpoint.load(folder.checkpoints, name)
        except CheckpointError as error:
            warnings.append(str(error))
            continue
        experiment = folder.description()["experiment"]
        if meta.get("experiment") != experiment:
            raise RunError(
                f"its checkpoint is of another experiment ({str(meta.get('experiment'))[:12]}) than the run"
                f" ({experiment[:12]})",
                where=str(folder.checkpoints / name),
                hint="the files of two runs were mixed; restore the folder from a copy",
            )
        if set(parts) != set(PARTS):
            raise RunError(
                f"its checkpoint holds {', '.join(sorted(parts))} and not {', '.join(PARTS)}",
                where=str(folder.checkpoints / name),
                hint="an older karolos made it: it can be played and tested, but not gone on with",
            )
        return Snapshot(parts, meta, tuple(warnings))
    if warnings:
        raise RunError("no checkpoint can be used: " + "; ".join(warnings), where=folder.id)
    return Snapshot({}, {"steps": 0, "episodes_bytes": 0})


def find_run(runs: Path, name: str, experiment: str, seed: int) -> RunFolder | None:
    """The run of this experiment and seed that is to be gone on with or, if there is a finished one, that one.

    Of several unfinished runs the one with the most steps. Looks at folders of that name and seed only.
    """
    found: list[tuple[bool, int, str, RunFolder]] = []
    for folder in scan(runs, f"{name}-s{seed}-*"):
        if isinstance(folder, RunError):
            continue
        description = folder.description()
        if (description["experiment"], description["seed"]) == (experiment, seed):
            state = folder.state()
            found.append((state.state == "finished", state.steps, folder.id, folder))
    return max(found, key=lambda one: one[:3])[3] if found else None
