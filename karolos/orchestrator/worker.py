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
from .executor import FAILURES, Executor, as_karolos_error, pack_errors
from .shared_memory import EnvironmentArrays, SharedBytes

DONE = b"."
FAILED = b"!"
NO_ENVIRONMENT = -1
"""The environment id in errors of building."""
ORPHAN_TIMEOUT = 2.0
"""Seconds for the channels to end by themselves after the parent has ended."""

Channel = tuple[Connection, range]
"""A connection and the ids of its environments."""


def work(number: int, recipe: bytes, channels: Sequence[Channel], size: int) -> None:
    """Run worker process `number`. `recipe` is a pickled pair (build, recipe); `size` counts all environments."""
    isolate()
    where = f"worker {number}"
    others = [Thread(target=_serve, args=(where, recipe, channel, size)) for channel in channels[1:]]
    for thread in others:
        thread.start()
    _serve(where, recipe, channels[0], size)
    for thread in others:
        thread.join()


def isolate() -> None:
    """Ignore signals, which the parent handles, and redirect standard output to standard error."""
    for name in (
        "SIGINT",
        "SIGTERM",
        "SIGHUP",
        "SIGUSR1",
    ):  # terminals and job schedulers send these to the process group
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
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


def _serve(where: str, recipe: bytes, channel: Channel, size: int) -> None:
    """Build the channel's environments and run commands until the connection ends."""
    connection, ids = channel
    with connection, suppress(EOFError, ConnectionError), ExitStack() as stack:
        try:
            build, contents = pickle.loads(recipe)
            executor = Executor(build, contents, len(ids), stack)
            signature = executor.signature
            answer = DONE + pickle.dumps(signature)
        except FAILURES as error:
            connection.send_bytes(FAILED + pack_errors([(NO_ENVIRONMENT, as_karolos_error(error, where))]))
            return
        connection.send_bytes(answer)
        buffer = SharedBytes.receive(connection, EnvironmentArrays.size(signature, size))
        executor.attach(EnvironmentArrays.over(buffer, signature, size), ids.start)
        while True:
            message = connection.recv_bytes()
            connection.send_bytes(execute(executor, message, where))


def packed(command: bytes, ids: NDArray[np.int64]) -> bytes:
    """The message for a command on these environments."""
    return command + ids.astype(np.uint32).tobytes()


def execute(executor: Executor, message: bytes, where: str) -> bytes:
    """Run a message's command on each of its environments; returns the answer."""
    command = message[:1]
    errors: list[tuple[int, KarolosError]] = []
    for index in np.frombuffer(message, np.uint32, offset=1).tolist():
        try:
            executor.run(command, index)
        except FAILURES as error:
            errors.append((index, as_karolos_error(error, f"{where}, environment {index}")))
    return FAILED + pack_errors(errors) if errors else DONE
