"""The series of a run in TensorBoard; docs/tensorboard.md says what each shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..errors import MachineError
from ..records.results import TestResult
from ..training.episodes import Episode
from ..training.training import Progress, Training
from .recording import Recorder
from .scalars import Scalars


class Series:
    """Collects what rounds tell, and writes a point of each series when it is asked for.

    Args:
        recorder: the run's; hears of points that cannot be written, and gets the episodes.
        scalars: where points go.
        training: at the point where the series begin or go on.
    """

    def __init__(self, recorder: Recorder, scalars: Scalars, training: Training) -> None:
        self._recorder, self._scalars = recorder, scalars
        self._finished: list[Episode] = []
        self._amounts = training.steps, training.updates
        """Steps and updates at the latest point."""

    def note(self, progress: Progress) -> None:
        """A round is over."""
        self._finished.extend(progress.finished)

    def report(self, training: Training) -> None:
        """Write down what happened since the last report.

        Raises:
            RunError: learning has come to numbers that are none.
        """
        means = training.read_metrics()
        episodes, self._finished = self._finished, []
        if episodes:
            self._recorder.episodes(episodes, training.orchestrator.signature.parameters.names)
        groups = {
            "agent": means,
            "buffer": training.buffer.metrics(),
            "speed": _speeds(training) | self._replay_ratio(training),
            "train": _episode_means(episodes),
        }
        with self._recorder.tolerated(MachineError, "these points are missing in TensorBoard"):
            self._write(groups, training.steps)

    def test(self, result: TestResult) -> None:
        """Write down a test."""
        with self._recorder.tolerated(MachineError, "this test is missing in TensorBoard"):
            self._write({"test": _test_means(result)}, result.steps)

    def _write(self, groups: Mapping[str, Mapping[str, float]], steps: int) -> None:
        for group, values in groups.items():
            self._scalars.add(group, values, steps)
        self._scalars.flush()

    def _replay_ratio(self, training: Training) -> dict[str, float]:
        """Transitions learned from per environment step since the latest point, as it really came out.

        Updates before the first step count with the steps that follow. An on-policy agent has no such ratio.
        """
        steps, updates = self._amounts
        if training.agent.on_policy or training.steps == steps:
            return {}
        self._amounts = training.steps, training.updates
        learned = (training.updates - updates) * training.amounts.batch_size
        return {"replay_ratio": learned / (training.steps - steps)}


def _speeds(training: Training) -> dict[str, float]:
    """How fast it goes, on the whole, and how old the policy behind its actions is since the latest point."""
    return {
        "steps_per_second": training.steps / training.seconds,
        "updates_per_second": training.updates / training.seconds,
        **training.collector.lag.read(),
    }


def _episode_means(episodes: Sequence[Episode]) -> dict[str, float]:
    """Of training episodes; nothing where there are none."""
    if not episodes:
        return {}
    return {
        "success_any": float(np.mean([episode.any for episode in episodes])),
        "success_end": float(np.mean([episode.end for episode in episodes])),
        "return": float(np.mean([episode.total_reward for episode in episodes])),
        "episode_length": float(np.mean([episode.steps for episode in episodes])),
        "diverged": float(np.mean([episode.diverged for episode in episodes])),
    }


def _test_means(result: TestResult) -> dict[str, float]:
    """Of a test's episodes."""
    return {
        "success_any": result.success_any,
        "success_end": result.success_end,
        "return": float(np.mean(result.returns)),
        "episode_length": float(np.mean(result.lengths)),
    }
