"""The process that a launcher has started: it executes the runs, and plays the tests, of folders that exist."""

from __future__ import annotations

import json
import os
import platform
import sys
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..errors import KarolosError, MachineError
from ..files import read_object, write_json, write_whole
from ..records import RunFolder, provenance
from ..records.run_records import RunSummary
from ..spec import spec_from_dict
from .events import Listener, RunAdvanced, RunBusy, RunEvent
from .resume import newest_snapshot
from .run import Run
from .run_index import RunIndex
from .signals import StopRequest, stop_on_signals
from .transfer_tests import execute_test, is_test

LOCK_SECONDS = 60.0
"""How long a run waits for an earlier process of the run, which writes a checkpoint and ends."""


def execute(folder: RunFolder, url: str | None, listener: Listener, stop: StopRequest, *, beside: bool) -> RunSummary:
    """Execute the run of a folder, or resume it from its newest checkpoint if it has begun. A finished run stays so.

    Args:
        folder: of the run, locked.
        url: SQLAlchemy URL of the results database; None: another process indexes the run.
        listener: is called with every RunEvent.
        stop: is checked after each round.
        beside: whether tests may be played beside training, in a second process.

    Raises:
        RunError: no checkpoint can be used.
        SpecError: its resolved spec is damaged, or of another version.
    """
    if folder.state().state == "finished":  # it may have been when the caller looked, before the lock was free
        return folder.summary()
    spec, seed = spec_from_dict(folder.spec()), folder.description()["seed"]
    snapshot = newest_snapshot(folder) if folder.events() else None
    if snapshot is not None:
        folder.next_attempt()
    with RunIndex(url, folder) as index:
        return Run(spec, seed, folder, index, listener, stop, snapshot, beside).execute()


def execute_folder(path: Path, cores: int, driver: int | None = None) -> str | None:
    """Execute the run or the test of a folder that another process follows. Returns why it could not be executed.

    Args:
        path: of the folder.
        cores: number of cores for a run.
        driver: id of the process with whose end it stops.
    """
    if is_test(path):
        return execute_test(path, driver)
    folder = None
    try:
        folder = RunFolder.open(path)
        with folder, stop_on_signals(file=folder.stop, driver=driver) as stop:
            folder.lock(LOCK_SECONDS)
            launch = read_object(folder.launch) or {}
            launch.pop("problem", None)  # of an earlier process
            if launch:
                provenance.check_software(launch, folder.id)
            write_json(folder.launch, launch | {"host": platform.node()})
            if not stop.requested:
                execute(folder, None, _progress_writer(folder), stop, beside=cores >= 2)
            folder.progress.unlink(missing_ok=True)
    except KarolosError as error:
        if folder is not None:
            with suppress(MachineError):
                write_json(folder.launch, (read_object(folder.launch) or {}) | {"problem": str(error)})
        return str(error)
    return None


def serve(cores: int) -> None:
    """Execute the runs and tests whose folders come on stdin, one a line; answer each on stdout when it has ended.

    The first answer says that libraries are imported. The others are what `execute_folder` returns, as JSON.
    """
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what libraries print does not mix with the answers
    from ..agents import device  # noqa: F401, PLC0415  (imports torch)

    driver = os.getppid()
    with suppress(BrokenPipeError):  # the driver has ended
        answers.write("null\n")
        for line in sys.stdin:
            answers.write(json.dumps(execute_folder(Path(line.removesuffix("\n")), cores, driver)) + "\n")


def _progress_writer(folder: RunFolder) -> Listener:
    """A listener that writes the latest progress into the folder."""
    latest: dict[str, Any] = {}

    def write(event: RunEvent) -> None:
        if isinstance(event, RunAdvanced | RunBusy):
            latest[type(event).__name__] = asdict(event)
            with suppress(MachineError):  # it is for display only
                write_whole(folder.progress, json.dumps(latest), durable=False)

    return write
