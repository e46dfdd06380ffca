"""Writes the scalars of a run for TensorBoard; docs/tensorboard.md explains each of them.

This module is the only one that imports tensorboard, which needs neither torch nor TensorFlow.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..errors import MachineError
from ..records import RunFolder
from ..records.checkpoint import read_meta
from ..records.evaluation import Evaluation
from ..specification.tree import leaves
from ..system.files import writing
from ..training.collecting import Episode
from ..training.training import Training
from .resume import Snapshot
from .writer import RunWriter


class TensorBoardWriter:
    """Writes one point of each scalar at every report and every test. A point that cannot be written is a warning.

    The event file is written in this thread: TensorBoard's own writer uses a thread whose errors nobody notices.

    TensorBoard hides the points after the snapshot in older files. Raises MachineError if the file cannot be created.
    """

    def __init__(self, folder: Path, writer: RunWriter, snapshot: Snapshot | None) -> None:
        # The import takes 0.2 s, so only a process that trains does it.
        from tensorboard.compat.proto.event_pb2 import Event, SessionLog  # noqa: PLC0415
        from tensorboard.compat.proto.summary_pb2 import Summary  # noqa: PLC0415
        from tensorboard.plugins.hparams.summary_v2 import hparams_pb  # noqa: PLC0415
        from tensorboard.summary.writer.record_writer import RecordWriter  # noqa: PLC0415

        self._event, self._summary, self._writer = Event, Summary, writer
        self._path = folder / f"events.out.tfevents.{time.time_ns()}.karolos"
        with writing(self._path):
            folder.mkdir(parents=True, exist_ok=True)
            first = not any(folder.glob("events.*"))
            self._file = self._path.open("xb")
        self._records = RecordWriter(self._file)
        self._records.write(Event(wall_time=time.time(), file_version="brain.Event:2").SerializeToString())
        if first:
            settings = {".".join(path): value for path, value in leaves(writer.folder.spec())}
            known = {key: value for key, value in settings.items() if isinstance(value, bool | int | float | str)}
            known.pop("name", None)
            shown = hparams_pb(known, writer.folder.description()["experiment"])  # the seeds of a spec are one group
            self._records.write(Event(wall_time=time.time(), summary=shown).SerializeToString())
        if snapshot is not None:
            purge = snapshot.meta["steps"] + 1  # points at these steps are not written again
            start = SessionLog(status=SessionLog.START)
            self._records.write(Event(wall_time=time.time(), step=purge, session_log=start).SerializeToString())

    def add_report(self, training: Training, episodes: Sequence[Episode], metrics: Mapping[str, float]) -> None:
        """Points of a part of training. Arguments as those of `Run._report`."""
        speed = {
            "steps_per_second": training.steps / training.seconds,
            "updates_per_second": training.updates / training.seconds,
            **training.collector.read_policy_lag(),
        }
        groups = {"agent": metrics, "buffer": training.buffer.metrics(), "speed": speed}
        has_success = training.orchestrator.signature.has_success
        names = {"success_any": "any", "success_end": "end"} if has_success else {}
        names |= {"return": "total_reward", "episode_length": "steps", "diverged": "diverged"}
        columns = {name: [getattr(one, field) for one in episodes] for name, field in names.items()}
        means = {name: float(np.mean(column)) for name, column in columns.items() if column}
        self._add(groups | {"train": means}, training.steps)

    def add_test(self, result: Evaluation) -> None:
        means = {"return": result.known_return, "episode_length": float(np.mean(result.lengths))}
        known = {name: one["mean"] for name, one in result.measures.items() if one["mean"] is not None}
        self._add({"test": _success(result) | means, "measures": known}, result.steps)

    def add_final(self, last: Evaluation) -> None:
        """Points of the final test of `last`: the metrics of TensorBoard's HParams."""
        success = {name: value for name, value in _success(last).items() if name == "success_end"}
        self._add({"final": success | {"return": last.known_return}}, last.steps)

    def close(self) -> None:
        with self._writer.tolerated(MachineError, "the last points are missing in TensorBoard"), writing(self._path):
            self._file.close()

    def _add(self, groups: Mapping[str, Mapping[str, float]], steps: int) -> None:
        """Write one point of each scalar `group/name` at this environment step."""
        consequence = f"points at {steps} steps are missing in TensorBoard"
        with self._writer.tolerated(MachineError, consequence), writing(self._path):
            for group, values in groups.items():
                points = [self._summary.Value(tag=f"{group}/{name}", simple_value=one) for name, one in values.items()]
                event = self._event(wall_time=time.time(), step=steps, summary=self._summary(value=points))
                self._records.write(event.SerializeToString())
            self._records.flush()


def add_film(folder: RunFolder, name: str, film: bytes, size: tuple[int, int]) -> None:
    """Show a film (GIF) of width and height `size`, of the policy in the checkpoint `name`.

    It gets a subfolder, because TensorBoard reads one growing file per folder.
    Raises MachineError when the file cannot be written.
    """
    from tensorboard.compat.proto.event_pb2 import Event  # noqa: PLC0415
    from tensorboard.compat.proto.summary_pb2 import Summary  # noqa: PLC0415
    from tensorboard.summary.writer.record_writer import RecordWriter  # noqa: PLC0415

    width, height = size
    image = Summary.Image(width=width, height=height, colorspace=3, encoded_image_string=film)
    shown = Summary(value=[Summary.Value(tag="film", image=image)])
    steps = read_meta(folder.checkpoints, name)["steps"]
    path = folder.tensorboard / "film" / f"events.out.tfevents.{time.time_ns()}.karolos"
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("xb") as file:
            records = RecordWriter(file)
            records.write(Event(wall_time=time.time(), file_version="brain.Event:2").SerializeToString())
            records.write(Event(wall_time=time.time(), step=steps, summary=shown).SerializeToString())
            records.flush()


def _success(test: Evaluation) -> dict[str, float]:
    """Success at the end and at any step, if it is defined."""
    known = {"success_any": test.success_any, "success_end": test.success_end}
    return {name: value for name, value in known.items() if value is not None}
