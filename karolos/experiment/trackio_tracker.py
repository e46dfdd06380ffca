"""Runs in trackio: in its own folder, TRACKIO_DIR."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import trackio
from trackio.sqlite_storage import SQLiteStorage
from typing_extensions import override

from .tracking import Tracked, Tracker


class TrackioTracker(Tracker):
    """A run of trackio with the name of the run.

    Trackio has one running run per process, so a run is open only while something is written.
    """

    def __init__(self, run: Tracked) -> None:
        self._tracked = run
        self._write({}, None)
        rows = SQLiteStorage.get_logs(run.project, run.id)
        self.known = {int(row["step"]) for row in rows if "test/return" in row}

    def _write(self, points: Mapping[str, float], steps: int | None) -> None:
        run, off = self._tracked, {"embed": False, "auto_log_gpu": False, "auto_log_cpu": False}
        with redirect_stdout(sys.stderr):  # which it prints on
            known: Any = {"name": run.id, "group": run.group, "config": run.settings, "resume": "allow"}
            opened = trackio.init(run.project, **known, **off)
            if points:
                opened.log(dict(points), step=steps)
            trackio.finish()

    @override
    def add(self, points: Mapping[str, float], steps: int) -> None:
        self._write(points, steps)

    @override
    def add_files(self, files: list[Path]) -> None:
        """Trackio keeps no files of a local run: they are in the run folder."""

    @override
    def end(self, state: str) -> None:
        """Nothing to do: no run stays open."""
