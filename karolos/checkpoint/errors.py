"""What is wrong with a checkpoint."""

from __future__ import annotations

from pathlib import Path

from ..errors import RunError


class CheckpointError(RunError):
    """A checkpoint that is missing, damaged, from a newer karolos or not to be trusted."""


def damaged(path: Path, why: str) -> CheckpointError:
    """The error that says so, and what to do."""
    return CheckpointError(
        f"the checkpoint is damaged: {why}", where=str(path), hint="use another checkpoint of the run, or train again"
    )
