"""Scalars of one run for TensorBoard. The only home of tensorboard; it needs neither torch nor TensorFlow."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path

from ..files import writing


class Scalars:
    """Writes an event file below `folder`, in this thread: tensorboard's own writer has one that dies unheard.

    Args:
        folder: the run's own; made if it is not there.
        purge: a run goes on after this step: what older files hold of later steps is not shown.

    Raises:
        MachineError: from every method, when the file cannot be written.
    """

    def __init__(self, folder: Path, *, purge: int | None = None) -> None:
        # 0.2 s of imports, paid only by a process that trains
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

    def add(self, group: str, values: Mapping[str, float], step: int) -> None:
        """One point of each series `group/name` at environment step `step`."""
        points = [self._summary.Value(tag=f"{group}/{name}", simple_value=value) for name, value in values.items()]
        event = self._event(wall_time=time.time(), step=step, summary=self._summary(value=points))
        with writing(self._path):
            self._records.write(event.SerializeToString())

    def flush(self) -> None:
        """Let readers see what was added."""
        with writing(self._path):
            self._records.flush()

    def close(self) -> None:
        """Safe to call twice."""
        with writing(self._path):
            self._file.close()
