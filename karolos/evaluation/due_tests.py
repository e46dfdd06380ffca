"""Tests of an agent as it was at some step: played in this process, or beside training in a second one.

A test depends on the agent's state and on fixed seeds alone. Its result is the same in every process.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from time import monotonic
from typing import Any

from .. import checkpoint
from ..core import Agent, Failure, Orchestrator, State
from ..core.seeding import SeedTree
from ..errors import WorkerError
from ..orchestrator.executor import FAILURES
from ..orchestrator.start import fresh_start
from ..orchestrator.worker import isolate
from ..records.results import TestResult
from ..spec import Spec, spec_from_dict
from ..training.assembly import make_agent, make_orchestrator
from .testing import play_episodes

NICENESS = 10
"""Is added to the second process's priority value: it gets about a tenth of a core that another process wants, too."""
SILENT_SECONDS = 300.0
"""The second process is killed if it has a test and says nothing for so long. It imports and builds in this time."""
PROGRESS_SECONDS = 0.2
"""Minimal time between two messages about the progress of a test."""
CLOSE_SECONDS = 3.0
"""Seconds for an idle process to end before it is killed."""


@dataclass(frozen=True, eq=False)
class DueTest:
    """A test that is due, or a part of one: the agent as it was, and how far training was."""

    steps: int
    updates: int
    seconds: float
    """Wall-clock seconds of collecting and learning."""
    agent: State
    seeds: tuple[int, ...]
    """One per episode."""


class TestPlayer:
    """Plays tests of a spec's agents. Makes its environments and its agent at the first test."""

    def __init__(self, spec: Spec) -> None:
        self._spec = spec
        self._environments: Orchestrator | None = None
        self._agent: Agent | None = None
        self._loaded: State | None = None

    def play(
        self, test: DueTest, on_failure: Callable[[Failure], object], on_round: Callable[[int], object]
    ) -> TestResult:
        """Play a test; `on_failure` and `on_round` as for `play_episodes`."""
        if self._environments is None:
            self._environments = make_orchestrator(self._spec, randomize=False)
        if self._agent is None:
            self._agent = make_agent(self._spec, self._environments.signature, SeedTree(0))
        if self._loaded is not test.agent:
            self._agent.load_state(test.agent)
            self._loaded = test.agent
        return play_episodes(
            self._environments,
            self._agent,
            test.seeds,
            steps=test.steps,
            seconds=test.seconds,
            on_failure=on_failure,
            on_round=on_round,
        )

    def close(self) -> None:
        """End the environments. Safe to call twice."""
        if self._environments is not None:
            self._environments.close()
            self._environments = None


class TestProcess:
    """A process of low priority that plays one test at a time. `receive` must be called regularly.

    Raises:
        OSError: the machine cannot start a process.
    """

    def __init__(self, spec: Spec) -> None:
        self.test: DueTest | None = None
        """The test that it plays; None: it waits for one."""
        self._sent: State | None = None
        """The agent of the test before."""
        self._heard = monotonic()
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, spec.dump()), name="test process")
        with fresh_start():
            self._process.start()
        theirs.close()

    def start(self, test: DueTest) -> None:
        """Begin a test. Does not wait. The process must be without a test."""
        self.test, self._heard = test, monotonic()
        agent = None if test.agent is self._sent else checkpoint.pack_state(test.agent)
        self._sent = test.agent
        with suppress(OSError):  # `receive` notices that the process has ended
            self._connection.send((agent, replace(test, agent={})))

    def receive(self, seconds: float = 0.0) -> Iterator[int | Failure | TestResult]:
        """What has happened since the last call: completed episodes, failures of environments, the result.

        Args:
            seconds: to wait for the first message.

        Raises:
            WorkerError: the process has ended, has failed or hangs.
        """
        try:
            while self._connection.poll(seconds):
                seconds, self._heard = 0.0, monotonic()
                message = self._connection.recv()
                if isinstance(message, str):
                    raise WorkerError(message)
                if isinstance(message, TestResult):
                    self.test = None
                yield message
        except (EOFError, OSError):
            self._process.join(1.0)
            raise WorkerError(f"the test process ended (exit code {self._process.exitcode})") from None
        if self.test is not None and monotonic() - self._heard > SILENT_SECONDS:
            raise WorkerError(f"the test process did not answer for {SILENT_SECONDS:g} s")

    def close(self) -> None:
        """End the process; a running test is lost. Safe to call twice."""
        self._connection.close()
        if self.test is not None:
            self._process.kill()
        self._process.join(CLOSE_SECONDS)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


TestPlayer.__test__ = TestProcess.__test__ = False  # type: ignore[attr-defined]  # pytest takes the names for tests


def _serve(connection: Connection, resolved: dict[str, Any]) -> None:
    """Play tests until the connection ends."""
    from ..agents.device import use_threads  # noqa: PLC0415  (imports torch)

    isolate()
    os.nice(NICENESS)
    with connection, suppress(EOFError, ConnectionError):
        try:
            spec = spec_from_dict(resolved)
            use_threads(spec.training.threads or 1)
            _play_tests(connection, TestPlayer(_with_fewer_workers(spec)))
        except (EOFError, ConnectionError):
            raise
        except FAILURES as error:
            connection.send(f"the test process failed: {type(error).__name__}: {error}")


def _with_fewer_workers(spec: Spec) -> Spec:
    """The spec, in whose test process no worker steps what the process itself can step instead of waiting."""
    part = spec.orchestrator
    if part.name != "local" or max(part.settings.processes, 1) * part.settings.threads > 1:
        return spec
    settings = part.settings.model_copy(update={"processes": 0})
    return spec.model_copy(update={"orchestrator": replace(part, settings=settings)})


def _play_tests(connection: Connection, player: TestPlayer) -> None:
    state: State = {}
    last = monotonic()

    def send_progress(completed: int) -> None:
        nonlocal last
        if monotonic() - last >= PROGRESS_SECONDS:
            last = monotonic()
            connection.send(completed)

    try:
        while True:
            agent, test = connection.recv()
            if agent is not None:
                state = checkpoint.unpack_state(agent)
            connection.send(player.play(replace(test, agent=state), connection.send, send_progress))
    finally:
        player.close()
