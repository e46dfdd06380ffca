"""Writes the scalars of a run for TensorBoard; docs/tensorboard.md explains each of them.

This module is the only one that imports tensorboard, which needs neither torch nor TensorFlow.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from typing_extensions import override

from ..errors import MachineError
from ..evaluation.due_tests import DueTest
from ..files import writing
from ..records.results import TestResult
from ..training.episodes import Episode
from ..training.training import Training
from .observer import Ending, RunObserver, RunWarnings
from .resume import Snapshot


class EventFile:
    """A TensorBoard event file below `folder`, written in this thread.

    TensorBoard's own writer uses a thread whose errors nobody notices.

    Args:
        folder: is created if it is missing.
        purge: TensorBoard hides the points at this step and after it in older files; None: a new run.

    Raises:
        MachineError: from every method, when the file cannot be written.
    """

    def __init__(self, folder: Path, *, purge: int | None = None) -> None:
        # Importing takes 0.2 s, which only a process that trains shall pay.
        from tensorboard.compat.proto.event_pb2 import Event, SessionLog  # noqa: PLC0415
        from tensorboard.compat.proto.summary_pb2 import Summary  # noqa: PLC0415
        from tensorboard.summary.writer.record_writer import RecordWriter  # noqa: PLC0415

        self._event, self._summary = Event, Summary
        self._path = folder / f"events.out.tfevents.{time.time_ns()}.karolos"
        with writing(self._path):
            folder.mkdir(parents=True, exist_ok=True)
            self._file = self._path.open("xb")
        self._records = RecordWriter(self._file)
        self._records.write(Event(wall_time=time.time(), file_version="brain.Event:2").SerializeToString())
        if purge is not None:
            start = SessionLog(status=SessionLog.START)
            self._records.write(Event(wall_time=time.time(), step=purge, session_log=start).SerializeToString())

    def add(self, groups: Mapping[str, Mapping[str, float]], step: int) -> None:
        """Write one point of each scalar `group/name` at this environment step."""
        for group, values in groups.items():
            points = [self._summary.Value(tag=f"{group}/{name}", simple_value=value) for name, value in values.items()]
            event = self._event(wall_time=time.time(), step=step, summary=self._summary(value=points))
            with writing(self._path):
                self._records.write(event.SerializeToString())
        with writing(self._path):
            self._records.flush()

    def close(self) -> None:
        with writing(self._path):
            self._file.close()


class TensorBoardWriter(RunObserver):
    """Writes one point of each scalar at every report and every test. A point that cannot be written is a warning.

    Args:
        folder: of the event files.
        warnings: of the run.
        snapshot: where the run resumes; None if it starts.
    """

    def __init__(self, folder: Path, warnings: RunWarnings, snapshot: Snapshot | None) -> None:
        self._folder, self._warnings = folder, warnings
        self._purge = snapshot.meta["steps"] + 1 if snapshot else None  # points at the checkpoint are not made again
        self._file: EventFile | None = None
        self._steps = self._updates = 0
        if snapshot is not None:
            self._steps, self._updates = snapshot.meta["steps"], snapshot.meta["updates"]

    @override
    def started(self) -> None:
        self._file = EventFile(self._folder, purge=self._purge)

    @override
    def reported(self, training: Training, episodes: Sequence[Episode], metrics: Mapping[str, float]) -> None:
        speed = {
            "steps_per_second": training.steps / training.seconds,
            "updates_per_second": training.updates / training.seconds,
            **training.collector.read_policy_lag(),
            **self._replay_ratio(training),
        }
        groups = {"agent": metrics, "buffer": training.buffer.metrics(), "speed": speed}
        has_success = training.orchestrator.signature.has_success
        self._add(groups | {"train": _episode_means(episodes, has_success=has_success)}, training.steps)

    @override
    def tested(self, training: Training, test: DueTest, result: TestResult) -> None:
        success = {"success_any": result.success_any, "success_end": result.success_end} if result.has_success else {}
        means = {"return": result.mean_return, "episode_length": float(np.mean(result.lengths))}
        self._add({"test": success | means}, result.steps)

    @override
    def ended(self, ending: Ending) -> None:
        with self._warnings.tolerated(MachineError, "the last points are missing in TensorBoard"):
            if self._file is not None:
                self._file.close()

    def _add(self, groups: Mapping[str, Mapping[str, float]], steps: int) -> None:
        with self._warnings.tolerated(MachineError, f"points at {steps} steps are missing in TensorBoard"):
            if self._file is not None:
                self._file.add(groups, steps)

    def _replay_ratio(self, training: Training) -> dict[str, float]:
        """Transitions learned from per environment step since the last point; empty for an on-policy agent.

        Updates before the first environment step count with the steps that follow.
        """
        if training.agent.on_policy or training.steps == self._steps:
            return {}
        learned = (training.updates - self._updates) * training.amounts.batch_size
        ratio = learned / (training.steps - self._steps)
        self._steps, self._updates = training.steps, training.updates
        return {"replay_ratio": ratio}


def _episode_means(episodes: Sequence[Episode], *, has_success: bool) -> dict[str, float]:
    """Means over training episodes; empty without episodes."""
    if not episodes:
        return {}
    success = {
        "success_any": float(np.mean([episode.any for episode in episodes])),
        "success_end": float(np.mean([episode.end for episode in episodes])),
    }
    return (success if has_success else {}) | {
        "return": float(np.mean([episode.total_reward for episode in episodes])),
        "episode_length": float(np.mean([episode.steps for episode in episodes])),
        "diverged": float(np.mean([episode.diverged for episode in episodes])),
    }
