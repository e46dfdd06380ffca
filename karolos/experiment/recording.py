"""Who is told what happens in a run: its folder first, which is the truth; then the store and the listener."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from typing import Any

from ..core import Failure
from ..errors import KarolosError, StoreError
from ..records import RunFolder
from ..records.results import TestResult
from ..records.run_records import RunSummary
from ..store import Store
from ..training.episodes import Episode
from ..training.training import Progress, Training
from .events import Listener, RunAdvanced, RunEnded, RunTested, RunWarned

ADVANCE_SECONDS = 0.1
"""How often a listener hears that the run has advanced."""


@dataclass
class Recorder:
    """Writes down what happens to one run.

    Args:
        folder: the run's own, created and locked.
        store: the index to keep up to date; what it refuses costs a warning.
        listener: is told what happens.

    Raises:
        MachineError: from every method, when the folder cannot be written.
    """

    folder: RunFolder
    store: Store
    listener: Listener
    _told_at: float = field(default=0.0, init=False)

    def state(self, state: str, training: Training | None = None, error: str | None = None) -> None:
        """The run is in this state from now on; `training` says how far it is."""
        if training is not None:
            self.folder.set_state(state, steps=training.steps, seconds=training.seconds, error=error)
        else:
            self.folder.set_state(state, error=error)
        with self.tolerated(StoreError, "the run goes on; its folder is complete"):
            self.store.update_run(self.folder.summary())

    def failed(self, error: str, trace: str | None) -> None:
        """The run ends here, because of `error`; `trace` is a traceback, where there is one."""
        self.state("failed", error=error.splitlines()[0])
        self.folder.event("failed", error=error, traceback=trace)

    def ended(self, error: str | None, trace: str | None) -> RunSummary:
        """Tell the listener that the run is over; returns its row."""
        summary = self.folder.summary()
        self.listener(RunEnded(self.folder.id, summary.state, error, trace))
        return summary

    def advanced(self, progress: Progress) -> None:
        """A round is over."""
        for failure in progress.failures:
            self.replaced(failure)
        now = time.monotonic()
        if now - self._told_at >= ADVANCE_SECONDS:
            self._told_at = now
            self.listener(
                RunAdvanced(
                    self.folder.id,
                    progress.steps,
                    progress.updates,
                    progress.episodes,
                    progress.seconds,
                    progress.warming_up,
                )
            )

    def replaced(self, failure: Failure) -> None:
        """Environments failed and have begun anew."""
        named = ", ".join(map(str, failure.environment.tolist()))
        self.warn(str(failure.error), f"the episodes of these environments begin anew: {named}")

    def episodes(self, episodes: Iterable[Episode], parameters: Sequence[str]) -> None:
        """Training episodes are over; `parameters` names what domain randomization draws."""
        self.folder.add_episodes(_episode_row(episode, parameters) for episode in episodes)

    def tested(self, result: TestResult, training: Training) -> None:
        """Keep a test's result for good."""
        self.folder.add_test(result)
        with self.tolerated(StoreError, "the test stands in the run folder, but not in the database"):
            self.store.add_test(self.folder.id, result)
        self.state("running", training)

    def told(self, result: TestResult) -> None:
        """Tell the listener of a test, once all that goes with it is written."""
        self.listener(RunTested(self.folder.id, result))

    @contextmanager
    def tolerated(self, kind: type[KarolosError], consequence: str) -> Iterator[None]:
        """What must not end a run that can go on without it: say so, note it, go on."""
        try:
            yield
        except kind as error:
            self.warn(str(error), consequence)

    def warn(self, warning: str, consequence: str) -> None:
        """Something went wrong, and the run goes on without it."""
        self.folder.event("warning", error=warning, consequence=consequence)
        self.listener(RunWarned(self.folder.id, f"{warning} ({consequence})"))


def _episode_row(episode: Episode, parameters: Sequence[str]) -> dict[str, Any]:
    """The episode as JSON values; what domain randomization drew stands under the parameters' names."""
    drawn = {"parameters": dict(zip(parameters, episode.parameters, strict=True))} if parameters else {}
    return {key: value for key, value in asdict(episode).items() if key != "parameters"} | drawn
