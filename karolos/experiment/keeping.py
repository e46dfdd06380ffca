"""The checkpoints of a run: `best`, the policy of the best test; `last`, from which the run can go on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from .. import checkpoint
from ..core import State
from ..errors import MachineError
from ..records.results import TestResult
from ..training.training import Training
from .recording import Recorder
from .resuming import BEFORE, LAST


@dataclass
class Keeper:
    """Writes a run's checkpoints. One that cannot be written costs a warning, and the one before is kept.

    Args:
        recorder: the run's.
        experiment: hash of the run's spec.
        seed: the run's.
    """

    recorder: Recorder
    experiment: str
    seed: int
    tested_at: int = field(default=0, init=False)
    """Environment steps at the latest test."""
    _best: tuple[float, float] = field(default=(-1.0, -1.0), init=False)
    _kept_at: int = field(default=-1, init=False)

    def tested(self, training: Training, result: TestResult) -> None:
        """A test is over: keep the agent if it is the best so far, and what the run can go on from."""
        self.tested_at = training.steps
        merit = (result.success_end, result.success_any)
        if merit >= self._best:  # of equals the later one, which has learned longer
            self._best = merit
            meta = {"success_any": result.success_any, "success_end": result.success_end}
            self._write("best", {"agent": training.agent.state()}, training, meta)
        self.keep(training)

    def keep(self, training: Training) -> None:
        """Write down all that the run needs to go on from here, bit for bit; the checkpoint before stays beside it."""
        if self._kept_at == training.steps:
            return
        self._kept_at = training.steps
        folder = self.recorder.folder
        parts = {
            "agent": training.agent.state(),
            "buffer": training.buffer.state(),
            "training": training.state(),
            "run": self._state(),
        }
        with self.recorder.tolerated(MachineError, "the checkpoint before is kept"):
            checkpoint.rename(folder.checkpoints, LAST, BEFORE)
        self._write(LAST, parts, training, {"episodes_bytes": folder.episodes_bytes()})

    def load(self, training: Training, parts: Mapping[str, State]) -> None:
        """Go on where `keep` wrote these parts."""
        training.agent.load_state(parts["agent"])
        training.buffer.load_state(parts["buffer"])
        training.load_state(parts["training"])
        own = parts["run"]
        self._best = (own["best_end"], own["best_any"])
        self.tested_at = own["tested_at"]

    def _state(self) -> State:
        return {"best_end": self._best[0], "best_any": self._best[1], "tested_at": self.tested_at}

    def _write(self, name: str, parts: Mapping[str, State], training: Training, more: Mapping[str, Any]) -> None:
        meta = {
            "experiment": self.experiment,
            "seed": self.seed,
            "steps": training.steps,
            "updates": training.updates,
            "seconds": training.seconds,
            **more,
        }
        consequence = f"the checkpoint {name!r} was not written; the one before is kept"
        with self.recorder.tolerated(MachineError, consequence):
            checkpoint.save(self.recorder.folder.checkpoints, name, parts, meta)
