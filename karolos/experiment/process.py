"""The process that a launcher starts: `python -m karolos.experiment.process --cores N [FOLDER]`.

It executes the run or the zero-shot test of an existing folder. Without FOLDER it reads folders from stdin, one per
line.
"""

from __future__ import annotations

from .interrupt import BriefInterrupt

with BriefInterrupt():
    import argparse
    import json
    import os
    import platform
    import sys
    from contextlib import ExitStack, suppress
    from dataclasses import asdict
    from pathlib import Path
    from typing import Any

    from .. import system
    from ..errors import KarolosError, MachineError
    from ..evaluation.zero_shot import ZeroShotTest
    from ..records import RunFolder, provenance
    from ..records.run_folder import LAUNCH, STOP
    from ..system.files import read_object, write_json, write_whole
    from ..training.assembly import import_libraries
    from .events import Listener, RunAdvanced, RunBusy, RunEvent
    from .run import run_or_resume
    from .signals import StopRequestedError, stop_on_signals

EARLIER_PROCESS_SECONDS = 60.0
"""Time that a run waits for an earlier process of the same run, which writes a checkpoint and ends."""


def execute_folder(path: Path, cores: int, driver: int | None = None) -> str | None:
    """Execute the run or the test of a folder that a driver follows. Returns the reason if it could not be executed.

    `driver` is a file descriptor of a pipe, which ends with the driver.
    """
    launch, problem, requeued = path / LAUNCH, None, False
    try:
        with ExitStack() as stack:
            test = ZeroShotTest.read(path)
            run = None if test is not None else stack.enter_context(RunFolder.open(path))
            stop = stack.enter_context(stop_on_signals(file=path / STOP, driver=driver))
            if run is not None:
                run.lock(EARLIER_PROCESS_SECONDS)
            launched = read_object(launch) or {}
            for key in ("problem", "ended"):  # of an earlier process
                launched.pop(key, None)
            if launched:
                provenance.check_software(launched, path.name)
            write_json(launch, launched | {"host": platform.node()})
            if test is not None:
                with suppress(StopRequestedError), stop.at_once():
                    test.play(lambda _: stop.check())
            elif run is not None:
                if not stop.requested:
                    run_or_resume(run, None, _progress_writer(run), stop, two_processes=cores >= 2)
                system.remove(run.progress, missing_ok=True)
            # A batch system that sent this signal starts another process.
            requeued = stop.signal is not None and stop.signal == system.REQUEUED
    except KarolosError as error:
        problem = str(error)
    if path.is_dir() and not requeued:
        with suppress(MachineError):
            said = {"ended": True} | ({} if problem is None else {"problem": problem})
            write_json(launch, (read_object(launch) or {}) | said)
    return problem


def serve(cores: int) -> None:
    """Execute the folders that come on stdin, one per line. Answer on stdout at the end of each.

    The first answer says that libraries are imported. The others are the results of `execute_folder`, as JSON.
    """
    answers = os.fdopen(os.dup(1), "w", buffering=1, encoding="utf-8")
    os.dup2(2, 1)  # output of libraries does not mix with the answers
    import_libraries()
    with open(0, encoding="utf-8", closefd=False) as orders, suppress(OSError):  # the driver has ended
        answers.write("null\n")
        for line in orders:
            answers.write(json.dumps(execute_folder(Path(line.removesuffix("\n")), cores, 0)) + "\n")


def _progress_writer(folder: RunFolder) -> Listener:
    """A listener that writes the latest progress into the folder."""
    latest: dict[str, Any] = {}

    def write(event: RunEvent) -> None:
        if isinstance(event, RunAdvanced | RunBusy):
            latest[type(event).__name__] = asdict(event)
            with suppress(MachineError):  # it is for display only
                write_whole(folder.progress, json.dumps(latest), durable=False)

    return write


def main() -> None:
    """Read the arguments. Exit code 1 if a folder could not be executed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cores", type=int, default=1, help="of a run")
    parser.add_argument("folder", type=Path, nargs="?", help="of a run or a test")
    arguments = parser.parse_args()
    if arguments.folder is None:
        serve(arguments.cores)
    else:
        sys.exit(execute_folder(arguments.folder, arguments.cores))


if __name__ == "__main__":
    main()
