"""Runs that ship with karolos: records of reference runs, each with its exported policy instead of checkpoints."""

from __future__ import annotations

from pathlib import Path

from .run_folder import RunFolder

FOLDER = Path(__file__).resolve().parent / "shipped_runs"
SHIPPED = "shipped:"
"""Before the name of a run that ships, where a run of one's own has the same name."""
POLICY = "policy.npz"
"""The policy `last` of the run; policy.json says which one it is."""


def shipped_names() -> tuple[str, ...]:
    """Names of the runs that ship, in alphabetical order."""
    return tuple(sorted(path.parent.name for path in FOLDER.glob(f"*/{POLICY}")))


def results_of(folder: RunFolder, runs: Path) -> RunFolder:
    """Where tests of a run's policies under changed settings are: its folder; of one that ships `runs`/shipped/NAME."""
    return RunFolder(runs / "shipped" / folder.path.name) if is_shipped(folder) else folder


def is_shipped(folder: RunFolder) -> bool:
    """Whether the run ships with karolos. Nothing is written into its folder."""
    return folder.path.resolve().parent == FOLDER
