"""Writes the checkpoints of a run: `best`, the agent of the best test; `last`, from which the run can resume."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from typing_extensions import override

from .. import checkpoint
from ..core import State
from ..errors import MachineError
from ..records import RunFolder
from ..records.results import TestResult
from ..training.training import Training
from .observer import RunObserver, RunWarnings
from .resume import LAST, PREVIOUS


@dataclass
class Checkpointer(RunObserver):
    """Writes checkpoints after each test and at the end of training.

    A checkpoint that cannot be written is a warning; the one before it stays.

    Args:
        folder: the run's.
        warnings: of the run.
        experiment: hash of the run's spec.
        seed: the run's.
    """

    folder: RunFolder
    warnings: RunWarnings
    experiment: str
    seed: int
    _best: tuple[float, float] = field(default=(-1.0, -1.0), init=False)
    """`success_end` and `success_any` of the best test."""
    _saved_at: int = field(default=-1, init=False)
    """Environment steps at the last checkpoint `last`."""

    @override
    def tested(self, training: Training, result: TestResult) -> None:
        success = result.success_end, result.success_any
        if success >= self._best:  # of equal tests the later one, whose agent has learned longer
            self._best = success
            meta = {"success_any": result.success_any, "success_end": result.success_end}
            self._write("best", {"agent": training.agent.state()}, training, meta)
        self._write_last(training)

    @override
    def trained(self, training: Training) -> None:
        self._write_last(training)

    def restore(self, training: Training, parts: Mapping[str, State]) -> None:
        """Continue from the parts of a checkpoint `last`."""
        training.agent.load_state(parts["agent"])
        training.buffer.load_state(parts["buffer"])
        training.load_state(parts["training"])
        self._best = parts["run"]["best_end"], parts["run"]["best_any"]

    def _write_last(self, training: Training) -> None:
        """Write everything that the run needs to resume bit for bit. The checkpoint before becomes `previous`."""
        if self._saved_at == training.steps:
            return
        self._saved_at = training.steps
        parts = {
            "agent": training.agent.state(),
            "buffer": training.buffer.state(),
            "training": training.state(),
            "run": {"best_end": self._best[0], "best_any": self._best[1]},
        }
        with self.warnings.tolerated(MachineError, "the checkpoint before is kept"):
            checkpoint.rename(self.folder.checkpoints, LAST, PREVIOUS)
        self._write(LAST, parts, training, {"episodes_bytes": self.folder.episodes_bytes()})

    def _write(self, name: str, parts: Mapping[str, State], training: Training, more: Mapping[str, Any]) -> None:
        meta = {
            "experiment": self.experiment,
            "seed": self.seed,
            "steps": training.steps,
            "updates": training.updates,
            "seconds": training.seconds,
            **more,
        }
        with self.warnings.tolerated(MachineError, f"the checkpoint {name!r} was not written; the one before is kept"):
            checkpoint.save(self.folder.checkpoints, name, parts, meta)
