"""A worker process: one lane per thread, each a connection and the environments it drives.

What travels on a connection, after the worker's first answer (its signature) and the parent's memory:
    to the worker    one command byte and the ids of the environments it is for, as uint32 numbers
    to the parent    DONE for each message, or FAILED and the errors of those environments that failed
A connection that ends means that the parent is gone or wants no more: the worker ends. Nothing here imports torch.
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
from .block import Block, SharedBytes
from .commands import FAILURES, Executor, as_karolos_error, pack_errors

DONE = b"."
FAILED = b"!"
NOBODY = -1
"""Stands for an environment's id in an error from before there were any."""
ORPHAN_PATIENCE = 2.0
"""Seconds that a worker's lanes get to end by themselves when the parent is gone."""

Lane = tuple[Connection, range]
"""A connection, and the ids of the environments behind it."""


def work(number: int, recipe: bytes, lanes: Sequence[Lane], size: int) -> None:
    """Body of worker process `number`. `recipe` is a pickled pair (build, recipe); `size` counts all environments."""
    _settle_in()
    where = f"worker {number}"
    others = [Thread(target=_drive, args=(where, recipe, lane, size)) for lane in lanes[1:]]
    for thread in others:
        thread.start()
    _drive(where, recipe, lanes[0], size)
    for thread in others:
        thread.join()


def _settle_in() -> None:
    """Make this process a quiet servant: the parent decides about signals, and owns standard output."""
    for name in ("SIGINT", "SIGTERM", "SIGUSR1"):  # terminals and job schedulers send them to the whole group
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    with suppress(OSError):  # no standard error to write to
        sys.stdout.flush()
        os.dup2(2, 1)
        faulthandler.enable()  # a crash in native code says where
    Thread(target=_outlive_no_parent, daemon=True).start()


def _outlive_no_parent() -> None:
    """End the process when the parent has vanished, even where a lane hangs in a step and reads no connection."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    wait([parent.sentinel])
    time.sleep(ORPHAN_PATIENCE)  # lanes that read their connection have ended by then, and this thread with them
    os._exit(1)


def _drive(where: str, recipe: bytes, lane: Lane, size: int) -> None:
    """Build the lane's environments and run commands until the connection ends."""
    connection, ids = lane
    with connection, suppress(EOFError, ConnectionError), ExitStack() as stack:
        try:
            build, contents = pickle.loads(recipe)
            executor = Executor(build, contents, len(ids), stack)
            signature = executor.signature
            answer = DONE + pickle.dumps(signature)
        except FAILURES as error:
            connection.send_bytes(FAILED + pack_errors([(NOBODY, as_karolos_error(error, where))]))
            return
        connection.send_bytes(answer)
        buffer = SharedBytes.receive(connection, Block.size(signature, size))
        executor.attach(Block.over(buffer, signature, size), ids.start)
        while True:
            message = connection.recv_bytes()
            connection.send_bytes(_obey(executor, message, where))


def packed(command: bytes, ids: NDArray[np.int64]) -> bytes:
    """A message to the worker."""
    return command + ids.astype(np.uint32).tobytes()


def _obey(executor: Executor, message: bytes, where: str) -> bytes:
    """Run a message's command on each environment that it names; the answer."""
    command = message[:1]
    errors: list[tuple[int, KarolosError]] = []
    for index in np.frombuffer(message, np.uint32, offset=1).tolist():
        try:
            executor.run(command, index)
        except FAILURES as error:
            errors.append((index, as_karolos_error(error, f"{where}, environment {index}")))
    return FAILED + pack_errors(errors) if errors else DONE
