"""Finds the run to resume and its checkpoint."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core import State
from ..errors import RunError
from ..records import RunFolder, checkpoint, scan
from ..records.checkpoint import CheckpointError
from ..records.run_folder import renamed
from ..specification import Spec

LAST, PREVIOUS = "last", "previous"
"""The newest checkpoint that a run can resume from, and the one before it, used if `last` is damaged."""
PARTS = ("agent", "buffer", "training", "run")
"""Parts of such a checkpoint."""


@dataclass(frozen=True)
class Snapshot:
    """Where a run resumes."""

    parts: dict[str, State]
    """The checkpoint's parts; empty if the run has no checkpoint and begins again."""
    meta: dict[str, Any]
    """The checkpoint's facts: experiment, seed, steps, updates, seconds, episodes_bytes."""
    checkpoint: str | None = None
    warnings: tuple[str, ...] = ()
    """Damaged checkpoints and the reasons."""


def newest_snapshot(folder: RunFolder) -> Snapshot:
    """The newest valid checkpoint that the run can resume from.

    Raises:
        RunError: the checkpoint belongs to another experiment or version, or all checkpoints are damaged.
    """
    warnings: list[str] = []
    existing = checkpoint.names(folder.checkpoints)
    for name in (LAST, PREVIOUS):
        if name not in existing:
            continue
        try:
            parts, meta = checkpoint.load(folder.checkpoints, name)
        except CheckpointError as error:
            warnings.append(str(error))
            continue
        experiment, what = folder.description()["experiment"], None
        if meta.get("experiment") != experiment:
            what = (
                f"belongs to another experiment ({str(meta.get('experiment'))[:12]}) than the run ({experiment[:12]})"
            )
        elif set(parts) != set(PARTS):
            what = f"contains {', '.join(sorted(parts))} instead of {', '.join(PARTS)}"
        elif wrong := [key for key in ("steps", "updates", "episodes_bytes") if type(meta.get(key)) is not int]:
            what = f"does not say {' and '.join(wrong)} as whole numbers"
        if what is not None:
            where = str(folder.checkpoints / name)
            raise RunError(f"its checkpoint {what}", where=where, hint="restore the folder from a copy")
        return Snapshot(parts, meta, name, tuple(warnings))
    if warnings:
        raise RunError("no checkpoint can be used: " + "; ".join(warnings), where=folder.id)
    return Snapshot({}, {"steps": 0, "updates": 0, "episodes_bytes": 0})


def learner_of(folder: RunFolder) -> dict[str, str]:
    """Device and precision with which the run learned last, as its events say; empty if they do not."""
    row: dict[str, Any] = next((row for row in reversed(folder.events()) if "device" in row), {})
    return {key: row[key] for key in ("device", "precision") if key in row}


def check_files(spec: Spec, folder: RunFolder) -> None:
    """Raise a RunError if a file that the run's spec names has changed since the run was made."""
    made, now = folder.description().get("files") or {}, spec.files()
    if changed := sorted(path for path, digest in made.items() if now.get(path) != digest):
        what = f"the file of {' and '.join(changed)}, or one that it names, was changed or is missing"
        hint = "put back what the run was made with; with other files it is another experiment"
        raise RunError(what, where=folder.id, hint=hint)


def find_run(runs: Path, name: str, experiment: str, seed: int) -> RunFolder | None:
    """The finished run of this experiment and seed; without one, the unfinished run with the most steps.

    Looks only at folders of that name and seed, and at renamed ones.

    Raises:
        RunError: a folder of that name and seed is damaged.
    """
    found: list[tuple[bool, int, str, RunFolder]] = []
    for folder in (*scan(runs, f"{name}-s{seed}-*"), *renamed(runs)):
        if isinstance(folder, RunError):
            raise folder  # it may be the right one: its training would be repeated
        description = folder.description()
        if (description["experiment"], description["seed"]) == (experiment, seed):
            state = folder.state()
            found.append((state.state == "finished", state.steps, folder.id, folder))
    return max(found, key=lambda one: one[:3])[3] if found else None
