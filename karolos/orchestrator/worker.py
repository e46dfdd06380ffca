"""The worker process: one thread per channel, which is a connection and its environments.

The worker first sends its signature and receives the shared memory. Then the messages are:
    to the worker    one byte for the command and the ids of its environments as uint32
    to the parent    DONE for each message, or FAILED and the errors of the environments that failed
The worker exits when a connection ends. This module does not import torch.
"""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import pickle
import signal
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from multiprocessing.connection import Connection, wait
from threading import Thread

import numpy as np
from numpy.typing import NDArray

from ..errors import KarolosError
from ..system import STOP_SIGNALS, SharedMemory, lower_priority
from .executor import FAILURES, EnvironmentArrays, Executor, as_karolos_error, pack_errors

DONE = b"."
FAILED = b"!"
NO_ENVIRONMENT = -1
"""The environment id in errors of building."""
WORKER_FAILURES = (*FAILURES, KeyboardInterrupt)
"""Workers ignore Ctrl-C: an interrupt comes from the environment."""
ORPHAN_TIMEOUT = 2.0
"""Seconds for the channels to end by themselves after the parent has ended."""


def work(number: int, packed_build: bytes, channels: Sequence[tuple[Connection, range]], size: int) -> None:
    """Run worker process `number`.

    Args:
        number: of the worker.
        packed_build: the pickled function that builds an environment.
        channels: a connection and the ids of its environments, for each thread.
        size: number of all environments, those of other workers included.
    """
    isolate()
    where = f"worker {number}"
    others = [Thread(target=_serve, args=(where, packed_build, *channel, size)) for channel in channels[1:]]
    for thread in others:
        thread.start()
    _serve(where, packed_build, *channels[0], size)
    for thread in others:
        thread.join()


def isolate(niceness: int = 0) -> None:
    """Ignore signals, which the parent handles, and redirect standard output to standard error.

    `niceness` lowers the process's priority.
    """
    if niceness:
        lower_priority(niceness)
    # Terminals and job schedulers send these to the process group.
    for number in STOP_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    with suppress(OSError):  # there may be no standard error
        sys.stdout.flush()
        os.dup2(2, 1)
        faulthandler.enable()  # prints the line of a crash in native code
    Thread(target=_exit_with_parent, daemon=True).start()


def _exit_with_parent() -> None:
    """End the process after the parent has ended, also while an environment hangs."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    wait([parent.sentinel])
    time.sleep(ORPHAN_TIMEOUT)  # without a hanging environment, the process has ended by then
    os._exit(1)


def _serve(where: str, packed_build: bytes, connection: Connection, ids: range, size: int) -> None:
    """Build a channel's environments and run commands until the connection ends."""
    with connection, suppress(EOFError, ConnectionError), ExitStack() as stack:
        executor, answer = build_environments(packed_build, len(ids), stack, where)
        connection.send_bytes(answer)
        if executor is None:
            return
        buffer = SharedMemory.receive(connection, EnvironmentArrays.size(executor.signature, size))
        executor.attach(EnvironmentArrays.over(buffer, executor.signature, size), ids.start)
        while True:
            message = connection.recv_bytes()
            connection.send_bytes(run_command(executor, message, where))


def build_environments(packed_build: bytes, count: int, stack: ExitStack, where: str) -> tuple[Executor | None, bytes]:
    """Build a worker's environments, which `stack` closes. The answer is their signature, or the error."""
    try:
        executor = Executor(pickle.loads(packed_build), count, stack)
        return executor, DONE + pickle.dumps(executor.signature)
    except WORKER_FAILURES as error:
        return None, FAILED + pack_errors([(NO_ENVIRONMENT, as_karolos_error(error, where))])


def command_message(command: bytes, ids: NDArray[np.int64]) -> bytes:
    """The message for a command on these environments."""
    return command + ids.astype(np.uint32).tobytes()


def environments_in(message: bytes) -> NDArray[np.uint32]:
    """The ids of the environments in a message."""
    return np.frombuffer(message, np.uint32, offset=1)


def run_command(executor: Executor, message: bytes, where: str) -> bytes:
    """Run a message's command on each of its environments; returns the answer."""
    command = message[:1]
    errors: list[tuple[int, KarolosError]] = []
    for index in environments_in(message).tolist():
        try:
            executor.run(command, index)
        except WORKER_FAILURES as error:
            errors.append((index, as_karolos_error(error, f"{where}, environment {index}")))
    return FAILED + pack_errors(errors) if errors else DONE
