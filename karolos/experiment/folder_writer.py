"""Writes a run into its folder, which is the truth, and then into the store, which is an index."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from typing_extensions import override

from ..errors import StoreError
from ..evaluation.due_tests import DueTest
from ..records import RunFolder
from ..records.final_test import FinalTest
from ..records.results import TestCounts, TestResult
from ..records.run_records import State
from ..training.episodes import Episode
from ..training.training import Training
from .observer import Ending, RunObserver, RunWarnings
from .resume import Snapshot
from .run_index import RunIndex


@dataclass
class FolderWriter(RunObserver):
    """Writes state, events, tests and episodes of one run.

    Args:
        folder: the run's own, created and locked.
        index: its entry in the database; an error of the database is a warning only.
        warnings: of the run.
        snapshot: where the run resumes; None if it starts.
        exact: whether the run resumes bit for bit.

    Raises:
        MachineError: from every method, when the folder cannot be written.
    """

    folder: RunFolder
    index: RunIndex
    warnings: RunWarnings
    snapshot: Snapshot | None
    exact: bool

    @override
    def started(self) -> None:
        if self.snapshot is not None and not self.exact:
            self.folder.cut_tests(self.snapshot.meta["steps"])
        self._set_state("running")
        if self.snapshot is None:
            self.folder.event("started")
            return
        attempt, steps = self.folder.state().attempt, self.snapshot.meta["steps"]
        self.folder.event("resumed", attempt=attempt, steps=steps, bit_exact=self.exact)
        self.folder.cut_episodes(self.snapshot.meta["episodes_bytes"])

    @override
    def reported(self, training: Training, episodes: Sequence[Episode], metrics: Mapping[str, float]) -> None:
        names = training.orchestrator.signature.parameters.names
        if episodes:
            self.folder.add_episodes(_episode_row(episode, names) for episode in episodes)

    @override
    def tested(self, training: Training, test: DueTest, result: TestResult) -> None:
        self.folder.add_test(result)
        self.folder.set_state("running", steps=training.steps, seconds=training.seconds, updates=training.updates)
        with self.warnings.tolerated(StoreError, "the test is in the run folder, but not in the database"):
            self.index.update()

    @override
    def final_tested(self, final: FinalTest) -> None:
        self.folder.write_final(final)
        self.folder.event(
            "final_test",
            seed=final.seed,
            last=asdict(TestCounts.of(final.last)),
            best=asdict(TestCounts.of(final.best)) if final.best else None,
        )

    @override
    def ended(self, ending: Ending) -> None:
        if ending.error is not None:
            self._set_state(ending.state, error=ending.error.splitlines()[0])
            self.folder.event(ending.state, error=ending.error, traceback=ending.traceback)
            return
        self._set_state(ending.state, ending.steps, ending.seconds, ending.updates)
        details = {"steps": ending.steps, "reason": ending.reason}
        self.folder.event(ending.state, **{key: value for key, value in details.items() if value is not None})

    def _set_state(
        self,
        state: State,
        steps: int | None = None,
        seconds: float | None = None,
        updates: int | None = None,
        error: str | None = None,
    ) -> None:
        self.folder.set_state(state, steps=steps, seconds=seconds, updates=updates, error=error)
        with self.warnings.tolerated(StoreError, "the run continues; its folder is complete"):
            self.index.update()


def _episode_row(episode: Episode, parameters: Sequence[str]) -> dict[str, Any]:
    """The episode as JSON values; the values that domain randomization drew stand under the parameters' names."""
    drawn = {"parameters": dict(zip(parameters, episode.parameters, strict=True))} if parameters else {}
    return {key: value for key, value in asdict(episode).items() if key != "parameters"} | drawn
