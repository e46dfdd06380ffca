"""A process that plays tests beside training, on a copy of what the agent has learned.

A test depends on the agent's state and on fixed seeds alone. Its result is the same in this process as in the one that
trains. The process has a low priority, so that a test waits where cores are scarce.
"""

from __future__ import annotations

import atexit
import multiprocessing
import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from time import monotonic
from typing import Any

from .. import checkpoint
from ..core import Failure, Orchestrator, State
from ..core.seeding import SeedTree
from ..environments.build import build_environment
from ..errors import WorkerError
from ..orchestrator.executor import FAILURES
from ..orchestrator.local import Local
from ..orchestrator.start import fresh_start
from ..orchestrator.worker import isolate
from ..records.results import TestResult
from ..spec import Spec, spec_from_dict
from ..training.assembly import make_agent, make_orchestrator
from .testing import play_episodes

NICENESS = 10
"""Is added to the process's priority value: it gets about a tenth of a core that another process wants, too."""
BUILD_TIMEOUT = 300.0
"""Seconds for the process to import libraries and build its environments."""
PROGRESS_SECONDS = 0.2
"""Minimal time between two messages about the progress of a test."""
CLOSE_TIMEOUT = 3.0
"""Seconds for an idle process to end before it is killed."""

READY = b"ready"


@dataclass(frozen=True, eq=False)
class DueTest:
    """A test that is due: the agent as it was, and how far training was."""

    steps: int
    updates: int
    seconds: float
    """Wall-clock seconds of collecting and learning."""
    agent: State
    seeds: tuple[int, ...]
    """One per episode."""


@dataclass(frozen=True)
class _Order:
    """To the process: play this test."""

    steps: int
    seconds: float
    agent: bytes | None
    """None: the agent of the order before."""
    seeds: tuple[int, ...]


class EvaluationProcess:
    """Plays one test at a time. `receive` must be called regularly.

    Args:
        spec: of the run.
        layout: what `Orchestrator.describe` returns for the run's environments.
    """

    def __init__(self, spec: Spec, layout: Mapping[str, Any]) -> None:
        self.test: DueTest | None = None
        """The test that it plays; None: it waits for one."""
        self.ready = False
        """Whether the environments are built."""
        self._agent: State | None = None
        """The agent that it has loaded."""
        steps_itself = _steps_itself(spec, layout)
        limit = getattr(spec.orchestrator.settings, "time_limit", None)
        self._time_limit = limit * layout["environments"] if limit and steps_itself else None
        self._last = monotonic()
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, spec.dump(), dict(layout)), name="test process")
        with fresh_start():
            self._process.start()
        theirs.close()
        atexit.register(self.close)  # before the interpreter waits for its child processes

    def play(self, test: DueTest) -> None:
        """Begin a test. Does not wait. The process must be ready and without a test."""
        self.test, self._last = test, monotonic()
        agent = None if test.agent is self._agent else checkpoint.pack_state(test.agent)
        self._agent = test.agent
        with suppress(OSError):  # `receive` notices that the process has ended
            self._connection.send(_Order(test.steps, test.seconds, agent, test.seeds))

    def receive(self, timeout: float = 0.0) -> Iterator[int | Failure | TestResult]:
        """What has happened since the last call: completed episodes, failures of environments, the result.

        Args:
            timeout: seconds to wait for the first message.

        Raises:
            WorkerError: the process has ended, has failed or hangs.
        """
        try:
            while self._connection.poll(timeout):
                timeout, self._last = 0.0, monotonic()
                message = self._connection.recv()
                if message == READY:
                    self.ready = True
                elif isinstance(message, str):
                    raise WorkerError(message)
                else:
                    if isinstance(message, TestResult):
                        self.test = None
                    yield message
        except (EOFError, OSError):
            self._process.join(1.0)
            raise WorkerError(f"the test process ended (exit code {self._process.exitcode})") from None
        limit = self._time_limit if self.ready else BUILD_TIMEOUT
        if limit and (self.test or not self.ready) and monotonic() - self._last > limit:
            self._process.kill()
            raise WorkerError(f"the test process did not answer for {limit:g} s")

    def close(self) -> None:
        """End the process; a running test is lost. Safe to call twice."""
        atexit.unregister(self.close)
        self._connection.close()
        if self.test is not None or not self.ready:
            self._process.kill()
        self._process.join(CLOSE_TIMEOUT)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _steps_itself(spec: Spec, layout: Mapping[str, Any]) -> bool:
    """Whether the process steps its environments itself: it would only wait for a single worker."""
    return spec.orchestrator.name == "local" and max(layout["processes"], 1) * layout["threads"] == 1


def _make_orchestrator(spec: Spec, layout: Mapping[str, Any]) -> Orchestrator:
    """The test environments in the layout of the run."""
    if spec.orchestrator.name != "local":
        return make_orchestrator(spec, randomize=False)
    settings: Any = spec.orchestrator.settings
    if _steps_itself(spec, layout):
        settings = settings.model_copy(update={"processes": 0})
    return Local(settings, partial(build_environment, spec.recipe(randomize=False)))


def _serve(connection: Connection, resolved: dict[str, Any], layout: dict[str, Any]) -> None:
    """Play tests until the connection ends."""
    from ..agents.device import use_threads  # noqa: PLC0415  (imports torch)

    isolate()
    os.nice(NICENESS)
    with connection, suppress(EOFError, ConnectionError):
        try:
            spec = spec_from_dict(resolved)
            use_threads(spec.training.threads or 1)
            with _make_orchestrator(spec, layout) as orchestrator:
                _play_tests(connection, spec, orchestrator)
        except (EOFError, ConnectionError):
            raise
        except FAILURES as error:
            connection.send(f"the test process failed: {type(error).__name__}: {error}")


def _play_tests(connection: Connection, spec: Spec, orchestrator: Orchestrator) -> None:
    agent = make_agent(spec, orchestrator.signature, SeedTree(0))
    connection.send(READY)
    last = monotonic()

    def send_progress(completed: int) -> None:
        nonlocal last
        if monotonic() - last >= PROGRESS_SECONDS:
            last = monotonic()
            connection.send(completed)

    while True:
        order: _Order = connection.recv()
        if order.agent is not None:
            agent.load_state(checkpoint.unpack_state(order.agent))
        connection.send(
            play_episodes(
                orchestrator,
                agent,
                order.seeds,
                steps=order.steps,
                seconds=order.seconds,
                on_failure=connection.send,
                on_round=send_progress,
            )
        )
