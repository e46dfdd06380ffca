"""Writes the checkpoints of a run: `best`, the agent of the best test; `last`, from which the run can resume."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

from ..core import State
from ..errors import MachineError
from ..evaluation.due_tests import DueEvaluation
from ..evaluation.testing import test_seeds
from ..records import RunFolder, checkpoint
from ..records.evaluation import Evaluation
from ..specification import Spec
from ..training.training import Training
from .resume import LAST, PREVIOUS
from .writer import RunWriter

BEST = "best"
PENDING = ("steps", "updates", "seconds", "agent")
"""Fields of a pending test that `last` contains."""
LONGEST_SECONDS = 300.0
"""A run without a checkpoint for this time writes one at its next report."""


@dataclass
class Checkpointer:
    """Writes checkpoints after each test, between tests that are far apart, and at the end of training.

    A checkpoint that cannot be written is a warning; the one before it stays.
    """

    writer: RunWriter
    spec: Spec
    seed: int
    pending: list[DueEvaluation]
    """Tests without a recorded result. The caller changes the list, and `last` contains it."""
    demonstrated: bool = field(default=True, init=False)
    """Whether the buffer holds the demonstrations of the spec, if it has any."""
    diverged: list[bool] = field(default_factory=list, init=False)
    """Whether each training episode since the last judgement diverged."""
    _best: tuple[float, ...] = field(default=(-1.0,), init=False)
    """`_rank` of the best test."""
    _saved_at: tuple[int, int] = field(default=(-1, 0), init=False)
    """Environment steps and pending tests at the last checkpoint `last`."""
    _saved_time: float = field(default_factory=perf_counter, init=False)
    last_is_whole: bool = field(default=False, init=False)
    """Whether the run resumed from `last` or wrote it. A `last` that may be damaged does not replace `previous`."""

    @property
    def _folder(self) -> RunFolder:
        return self.writer.folder

    def tested(self, training: Training, test: DueEvaluation, result: Evaluation) -> None:
        """A test is over. Training may have gone on since it was due."""
        self._choose(test, result)
        if test.steps == training.steps:
            self.save(training)

    def _choose(self, test: DueEvaluation, result: Evaluation) -> None:
        """Write the tested agent as `best` if no earlier test is better."""
        rank = _rank(result)
        if rank >= self._best:  # among equal tests the later one, because its agent has learned longer
            chosen_by: dict[str, float | None] = {"success_any": result.success_any, "success_end": result.success_end}
            if not result.has_success:
                chosen_by = {"mean_return": result.mean_return}
            if self._write(BEST, {"agent": test.agent}, test, {"chosen_by": chosen_by}):
                self._best = rank

    def restore(self, training: Training, parts: Mapping[str, State]) -> list[DueEvaluation]:
        """Continue from the parts of a checkpoint `last`; returns the tests that are still to be played.

        Raises:
            CheckpointError: the parts do not fit the run's spec.
        """
        with checkpoint.fitting(str(self._folder.checkpoints)):
            run = parts["run"]
            self.demonstrated = bool(run["demonstrated"])
            self.diverged[:] = run.get("diverged", ())
            self._best = tuple(map(float, run["best"]))
            seeds = test_seeds(self.spec.testing.seed, self.spec.testing.episodes)
            tests = [DueEvaluation(**row | {"seeds": seeds}) for row in run["tests"]]
            for state in (*(test.agent for test in tests), parts["agent"]):  # a pending test's may not fit either
                training.agent.load_state(state)
            training.buffer.load_state(parts["buffer"])
            training.load_state(parts["training"])
        if strayed := ", ".join(map(str, training.collector.strayed)):
            self.writer.warn(
                f"the running episodes of these environments were played again and gave another observation: {strayed}",
                "the run resumes, but not bit for bit: seeds and actions do not determine these episodes",
            )
        results = {result.steps: result for result in self._folder.tests()}
        for test in tests:
            if test.steps in results:  # it was recorded after the checkpoint
                self._choose(test, results[test.steps])
        return [test for test in tests if test.steps not in results]

    def reported(self, training: Training) -> None:
        """Episodes and metrics of training until now are written: a run that is killed can continue from here."""
        if perf_counter() - self._saved_time >= LONGEST_SECONDS:
            self.save(training)

    def save(self, training: Training) -> None:
        """Write `last`: what the run needs to resume bit for bit. The checkpoint before becomes `previous`."""
        if self._saved_at == (training.steps, len(self.pending)):
            return
        self._saved_time = perf_counter()
        self.writer.announce("checkpoint", 0, 1)
        parts = {
            "agent": training.agent.state(),
            "buffer": training.buffer.state(),
            "training": training.state(),
            "run": {
                "best": list(self._best),
                "demonstrated": self.demonstrated,
                "diverged": list(self.diverged),
                "tests": [{name: getattr(test, name) for name in PENDING} for test in self.pending],
            },
        }
        if self.last_is_whole:
            with self.writer.tolerated(MachineError, "the checkpoint before is kept"):
                checkpoint.rename(self._folder.checkpoints, LAST, PREVIOUS)
        self.last_is_whole = self._write(LAST, parts, training, {"episodes_bytes": self._folder.episodes_bytes()})
        if self.last_is_whole:
            self._saved_at = training.steps, len(self.pending)
        self.writer.announce("checkpoint", 1, 1)

    def require(self, training: Training) -> None:
        """Try again to write `last` if it is not on the disk. Raises MachineError if that fails again."""
        if self._saved_at[0] != training.steps:
            self.save(training)
        if self._saved_at[0] != training.steps:
            raise MachineError(
                "the policy at the end of training could not be written",
                where=str(self._folder.checkpoints),
                hint="free some space; `karolos resume` continues from the last checkpoint that was written, if any",
            )

    def _write(
        self, name: str, parts: Mapping[str, State], at: Training | DueEvaluation, more: Mapping[str, Any]
    ) -> bool:
        """Write a checkpoint; returns whether it is on the disk."""
        amounts = {"steps": at.steps, "updates": at.updates, "seconds": at.seconds}
        meta = {"experiment": self._folder.description()["experiment"], "seed": self.seed, **amounts, **more}
        consequence = f"the checkpoint {name!r} was not written; the one before, if any, is kept"
        with self.writer.tolerated(MachineError, consequence):
            checkpoint.save(self._folder.checkpoints, name, parts, meta)
            return True
        return False


def _rank(result: Evaluation) -> tuple[float, ...]:
    """Key by which tests are compared: success, or return if the environment does not define success.

    A return that is not finite is the worst, because nan would stay the best for ever.
    """
    if result.success_end is None or result.success_any is None:
        return 0.0, -math.inf if result.mean_return is None else result.mean_return
    return 1.0, result.success_end, result.success_any
