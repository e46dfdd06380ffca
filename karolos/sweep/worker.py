"""A worker process of a sweep: executes one run after another for its pool.

It holds a lock file while it runs, so that a sweep whose parent was killed is not started again beside orphans. When
the parent has ended, the worker writes a checkpoint and exits.
"""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from ..errors import KarolosError
from ..experiment.events import RunEvent
from ..experiment.experiment import SeedRunner
from ..experiment.signals import StopRequest, stop_on_signals
from ..files import FileLock
from ..records.run_records import RunSummary
from ..spec import Spec
from ..training.assembly import check_parts

_LOCK_SECONDS = 10.0


@dataclass(frozen=True)
class Begin:
    """To the worker: execute this run."""

    seed: int
    spec: dict[str, Any]


@dataclass(frozen=True)
class Halt:
    """To the worker: stop the run with a checkpoint."""

    word: str


@dataclass(frozen=True)
class Ready:
    """From the worker: it holds its lock and is idle."""


@dataclass(frozen=True)
class Refused:
    """From the worker: the run could not be started."""

    error: str


def work(pipe: Connection, lock: Path, runner: SeedRunner) -> None:
    """Execute runs until the parent closes the pipe or ends."""
    life = FileLock(lock)
    if not life.acquire(_LOCK_SECONDS):
        raise SystemExit(f"{lock} is held by another process")
    with stop_on_signals(interrupt=False) as stop:

        def tell(event: RunEvent) -> None:
            try:
                pipe.send(event)
                while pipe.poll():
                    message = pipe.recv()
                    if isinstance(message, Halt):
                        stop.program_reason = message.word
            except (BrokenPipeError, ConnectionResetError, EOFError):  # the parent has ended: stop as after SIGTERM
                stop.signal = signal.SIGTERM

        try:
            pipe.send(Ready())
            while stop.signal is None:
                message = pipe.recv()
                if isinstance(message, Begin):  # otherwise a Halt for a run that has ended
                    stop.program_reason = None
                    pipe.send(_outcome(replace(runner, resolved=message.spec), message.seed, tell, stop))
        except (BrokenPipeError, ConnectionResetError, EOFError):
            pass
    life.release()


def _outcome(
    runner: SeedRunner, seed: int, tell: Callable[[RunEvent], None], stop: StopRequest
) -> RunSummary | Refused:
    try:
        check_parts(Spec.from_dict(runner.resolved))
        return runner(seed, tell, stop)
    except KarolosError as error:
        return Refused(str(error))
