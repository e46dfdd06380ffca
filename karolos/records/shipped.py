"""The shipped runs: records of reference runs, each with its exported policy in place of checkpoints."""

from __future__ import annotations

from pathlib import Path

from .run_folder import RunFolder

FOLDER = Path(__file__).resolve().parent / "shipped_runs"
SHIPPED = "shipped:"
"""Prefix of a shipped run's name. It is needed if an own run has the same name."""
POLICY = "policy.npz"
"""The policy `last` of the run; policy.json says which one it is."""


def shipped_names() -> tuple[str, ...]:
    """Names of the shipped runs, in alphabetical order."""
    return tuple(sorted(path.parent.name for path in FOLDER.glob(f"*/{POLICY}")))


def results_of(folder: RunFolder, runs: Path) -> RunFolder:
    """Folder of the tests under changed settings: the run's folder; for a shipped run `runs`/shipped/NAME."""
    return RunFolder(runs / "shipped" / folder.path.name) if is_shipped(folder) else folder


def is_shipped(folder: RunFolder) -> bool:
    """Whether the run is a shipped one. Nothing is written into its folder."""
    return folder.path.resolve().parent == FOLDER
