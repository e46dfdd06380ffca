"""Runs several seeds at the same time, each in its own process. The parent passes on their events."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any

from ..records.run_records import RunSummary
from .events import Listener, RunEnded, RunEvent, RunStarted
from .signals import StopRequest, stop_on_signals

POLL_SECONDS = 0.2
"""Time within which the parent notices a stop request."""


UNGUARDED = 79
"""Exit code of a process that runs the main script again, because the script has no guard."""

Work = Callable[[int, Listener, StopRequest], RunSummary]
"""Runs one seed. It is called in a new process, and therefore pickled."""
Lost = Callable[[int, str | None, str], RunSummary]
"""The row of a run from its seed, its folder (None: it had not begun) and how its process ended."""


@dataclass
class _Job:
    process: Any
    connection: Connection
    seed: int
    begun: RunStarted | None = None
    summary: RunSummary | None = None


def run_side_by_side(
    work: Work, lost: Lost, seeds: Sequence[int], jobs: int, listener: Listener, stop: StopRequest
) -> list[RunSummary]:
    """Run every seed, `jobs` at a time. Returns the summaries of the runs, also of those whose process died.

    A stop request reaches the running processes as SIGTERM (checkpoint, then stop); no further seed starts.
    """
    waiting = list(seeds)
    running: list[_Job] = []
    summaries: list[RunSummary] = []
    stopping = False
    while waiting or running:
        if stop.requested and not stopping:
            stopping = True
            waiting.clear()
            for job in running:
                job.process.terminate()
        while waiting and len(running) < jobs:
            seed = waiting.pop(0)
            running.append(_Job(*start_process(_in_process, work, seed), seed))
        for connection in wait([job.connection for job in running], POLL_SECONDS):
            job = next(job for job in running if job.connection is connection)
            if not _receive(job, listener):
                running.remove(job)
                summaries.append(_finish(job, lost, listener))
    return summaries


def start_process(target: Callable[..., None], *arguments: object) -> tuple[Any, Connection]:
    """Start `target(connection, *arguments)` in a new process; returns the process and the connection's other end."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=target, args=(theirs, *arguments))
    with sigint_ignored():  # the child inherits it: Ctrl-C reaches the parent, which decides
        process.start()
    theirs.close()
    return process, ours


def exit_cause(process: Any) -> str:
    """How a process ended, for messages: "was killed by signal 9" or "ended with exit code 1"."""
    code = process.exitcode
    if code == UNGUARDED:
        return 'ran the main script again, which has no `if __name__ == "__main__":` around its calls'
    return f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"


def exit_if_imported_by_child() -> None:
    """End a new process that runs the main script again; `exit_cause` names the reason in its parent."""
    if getattr(multiprocessing.current_process(), "_inheriting", False):  # as multiprocessing.spawn tests it
        raise SystemExit(UNGUARDED)


@contextmanager
def sigint_ignored() -> Iterator[None]:
    """Processes started in the block ignore SIGINT."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _receive(job: _Job, listener: Listener) -> bool:
    """Pass on one message; False after the last one."""
    try:
        message = job.connection.recv()
    except (EOFError, OSError):  # also in the middle of a message
        return False
    if isinstance(message, RunSummary):
        job.summary = message
        return True
    if isinstance(message, RunStarted):
        job.begun = message
    listener(message)
    return True


def _finish(job: _Job, lost: Lost, listener: Listener) -> RunSummary:
    job.process.join()
    job.connection.close()
    if job.summary is not None:
        return job.summary
    cause = f"its process {exit_cause(job.process)}" + ("" if job.begun else " before the run began")
    summary = lost(job.seed, job.begun.folder if job.begun else None, cause)
    if summary.state != "finished":
        listener(RunEnded(summary.run, summary.state, cause))
    return summary


def _in_process(connection: Connection, work: Work, seed: int) -> None:
    with stop_on_signals(interrupt=False) as stop:

        def send(event: RunEvent) -> None:
            try:
                connection.send(event)
            except BrokenPipeError:  # the parent has ended: stop as after SIGTERM
                stop.signal = signal.SIGTERM

        connection.send(work(seed, send, stop))
    connection.close()
