"""A pool of workers: sends commands, detects failures, replaces lost workers. Subclasses start the workers."""

from __future__ import annotations

import pickle
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from time import monotonic, sleep
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core import Failure, Signature
from ..errors import KarolosError, MachineError, PluginError, WorkerError
from .executor import RESET, STEP, EnvironmentArrays, Group, Ids
from .worker import DONE, command_message

CLOSE_TIMEOUT, BUSY_TIMEOUT = 3.0, 0.4
"""Seconds for workers to close their environments before they are killed, and before that to answer a command."""
BUILD_TIMEOUT = 300.0
"""Seconds for a worker to build its environments: the first import of a large library may take a minute."""
CHECK_INTERVAL = 1.0
"""Largest number of seconds between two checks for hanging workers."""
MOST_PLANS = 64
"""Number of sets of environments whose messages are kept. Limits the memory if episodes end at random times."""


class Worker:
    """A process of this machine, or an actor of Ray, that runs environments.

    Args:
        number: of the worker.
        connections: one for each channel: of multiprocessing, or objects with their methods.
        ids: the environments of each channel.
        end: waits the given seconds for a worker whose connections are closed, then kills it. Returns how it ended,
            and what to do.
    """

    def __init__(
        self, number: int, connections: Sequence[Any], ids: Sequence[range], end: Callable[[float], tuple[str, str]]
    ) -> None:
        self.number, self.end = number, end
        self.channels = [Channel(self, *channel) for channel in zip(connections, ids, strict=True)]
        self.lost: KarolosError | None = None
        """Why the worker ended; None while it runs."""

    @property
    def environments(self) -> Ids:
        return np.arange(self.channels[0].ids.start, self.channels[-1].ids.stop)

    def error(self, what: str, hint: str) -> WorkerError:
        """A WorkerError that names the worker and its environments."""
        ids = self.environments
        named = f"environments {ids[0]} to {ids[-1]}" if ids.size > 1 else f"environment {ids[0]}"
        return WorkerError(f"{what}, with {named}", where=f"worker {self.number}", hint=hint)


class Channel:
    """The connection to a part of a worker's environments. It is ready once they are built and share memory."""

    def __init__(self, worker: Worker, connection: Any, ids: range) -> None:
        self.worker, self.connection, self.ids = worker, connection, ids
        self.ready = False
        self.pending: deque[Group] = deque()
        """The groups of the commands without an answer, oldest first."""
        self._backlog: list[bytes] = []
        self._sent = 0
        self._progress = (-1, -1)
        self._since = monotonic()

    @property
    def busy(self) -> bool:
        """Whether an answer is missing: to a command, or the first one after building."""
        return bool(self.pending) or not self.ready

    def send(self, message: bytes, group: Group) -> None:
        """Send a command for a group, or queue it until the channel is ready. Ignores a closed connection."""
        self.pending.append(group)
        self._sent += 1
        self._backlog.append(message)
        if self.ready:
            self.open()

    def open(self) -> None:
        """Mark the channel as ready and send the queued commands."""
        self.ready = True
        with suppress(OSError):
            for message in self._backlog:
                self.connection.send_bytes(message)
        self._backlog.clear()

    def receive(self) -> bytes | None:
        """The next message; None if the connection has ended."""
        try:
            message: bytes = self.connection.recv_bytes()
            return message
        except (EOFError, OSError):
            return None

    def stalled_seconds(self, commands: NDArray[np.uint64] | None, now: float) -> float:
        """Seconds without a completed command; 0 for an idle channel. `commands` counts those of each environment."""
        completed = 0 if commands is None else int(commands[self.ids.start : self.ids.stop].sum())
        progress = (self._sent, completed)
        if progress != self._progress or not self.busy:
            self._progress, self._since = progress, now
        return now - self._since


class WorkerPool(ABC):
    """Runs commands on environments in workers.

    Worker i has the channels of `layout[i]`, each with the ids of its environments. A worker that ends, or takes longer
    than `time_limit` seconds for one command, is a failure of all its environments. The next reset of one of them
    starts another worker. A worker that ends while it builds its environments for the first time is replaced at once,
    up to `failures` times.
    """

    signature: Signature
    arrays: EnvironmentArrays
    """The arrays that environments read and write."""

    def __init__(self, layout: Sequence[Sequence[range]], time_limit: float, failures: int) -> None:
        self._layout = layout
        counts = [len(ids) for ranges in layout for ids in ranges]
        self._channel_of = np.repeat(np.arange(len(counts)), counts)
        """The place in `_channels` of each environment's channel."""
        self._size = sum(counts)
        self._time_limit = time_limit
        self._check_interval = min(CHECK_INTERVAL, time_limit / 4)
        self._next_check = monotonic() + self._check_interval
        self._connected = False
        """Whether the signature is known and the arrays are allocated."""
        self._workers: list[Worker] = []
        self._any_lost = False
        self._done: list[Group] = []
        self._failures: list[Failure] = []
        """Results that `collect` has not returned yet."""
        self._plans: dict[bytes, list[tuple[Channel, Group, dict[bytes, bytes]]]] = {}
        try:
            for number in range(len(layout)):
                self._workers.append(self._start(number))
            self._wait_until_ready(failures)
        except BaseException:  # also an interrupt, so that no worker stays behind
            self.close()
            raise

    @abstractmethod
    def _start(self, number: int) -> Worker:
        """Start a worker, which builds its environments. Raises MachineError if the machine cannot start it."""

    @abstractmethod
    def _allocate(self, signature: Signature) -> EnvironmentArrays:
        """The arrays of all environments."""

    @abstractmethod
    def _share(self, channel: Channel) -> None:
        """Let a channel use the arrays."""

    @abstractmethod
    def _readable(self, timeout: float) -> list[Channel]:
        """The channels with a message or an ended connection; waits up to `timeout` seconds for one."""

    def _disconnect(self, worker: Worker) -> None:
        """Close a worker's connections, which makes it exit."""
        for channel in worker.channels:
            channel.connection.close()

    def _seconds_allowed(self, channel: Channel) -> float:  # noqa: ARG002  (others depend on it)
        """Seconds until a ready channel must show progress."""
        return self._time_limit

    @property
    def _channels(self) -> list[Channel]:
        return [channel for worker in self._workers for channel in worker.channels]

    def _wait_until_ready(self, failures: int) -> None:
        """Wait until every environment is built. Raises the error of building one, or of a worker that ends again."""
        losses = [0] * len(self._workers)
        while not all(channel.ready for channel in self._channels):
            _, failed = self.collect()
            for failure in failed:
                number = self._channels[self._channel_of[failure.environment[0]]].worker.number
                if not failure.lost or losses[number] == failures:
                    raise failure.error
                losses[number] += 1
                self._workers[number] = self._start(number)
        self._any_lost = False

    def send(self, command: bytes, environments: Group) -> None:
        """Start a command on idle environments. Does not wait and does not raise."""
        if self._any_lost and command == RESET:
            self._replace(environments.ids)
        key = environments.ids.tobytes()
        plan = self._plans.get(key)
        if plan is None:
            if len(self._plans) >= MOST_PLANS:
                self._plans.clear()
            # The channels of these environments, the environments of each, and the message for each command.
            places, channels, plan = self._channel_of[environments.ids], self._channels, []
            for place in np.unique(places).tolist():
                ids = environments.ids[places == place]
                messages = {one: command_message(one, ids) for one in (RESET, STEP)}
                plan.append((channels[place], Group.of(ids), messages))
            self._plans[key] = plan
        for channel, group, messages in plan:
            if channel.worker.lost:
                self._failures.append(Failure(group.ids, channel.worker.lost, lost=True))
            else:
                channel.send(messages[command], group)

    def _replace(self, environments: Ids) -> None:
        """Replace the lost workers of these environments."""
        channels = self._channels
        for number in sorted({channels[place].worker.number for place in self._channel_of[environments]}):
            if self._workers[number].lost:
                with suppress(MachineError):  # the worker stays lost, and fails again
                    self._workers[number] = self._start(number)
        self._plans.clear()
        self._any_lost = any(worker.lost for worker in self._workers)

    def collect(self, *, wait: bool = True) -> tuple[list[Group], list[Failure]]:
        """The environments that have completed their commands since the last call, and the failures.

        With `wait`, blocks for a limited time until there are some; both may be empty.
        """
        for channel in self._readable(self._check_interval if wait and not self._failures else 0.0):
            if not channel.worker.lost:  # an earlier channel of this worker may have reported its end
                self._read(channel)
        now = monotonic()
        if now >= self._next_check:
            self._next_check = now + self._check_interval
            self._check_for_hangs(now)
        found = self._done, self._failures
        self._done, self._failures = [], []
        return found

    def _read(self, channel: Channel) -> None:
        message = channel.receive()
        if message is None:
            self._lose(channel.worker)
        elif not channel.ready:
            self._connect(channel, message)
        elif message[:1] == DONE:
            self._done.append(channel.pending.popleft())
        else:
            failed = pickle.loads(message[1:])
            self._failures.extend(Failure(np.array([index]), error) for index, error in failed)
            self._done.append(Group.of(np.setdiff1d(channel.pending.popleft().ids, [index for index, _ in failed])))

    def _connect(self, channel: Channel, message: bytes) -> None:
        """Handle a channel's first message: the signature of its environments, or why they could not be built."""
        if message[:1] != DONE:
            self._lose(channel.worker, pickle.loads(message[1:])[0][1])
            return
        signature: Signature = pickle.loads(message[1:])
        if not self._connected:
            self.signature, self.arrays, self._connected = signature, self._allocate(signature), True
        elif _widths(signature) != _widths(self.signature):
            error = PluginError(
                "environments of one spec have different observations, goals or actions",
                setting="orchestrator",
                hint="an environment's signature must depend only on its settings",
            )
            self._lose(channel.worker, error)
            return
        with suppress(ConnectionError):  # `_readable` reports a worker that has ended
            self._share(channel)
        channel.open()

    def _check_for_hangs(self, now: float) -> None:
        for channel in self._channels:
            worker = channel.worker
            if worker.lost:
                continue
            stalled = channel.stalled_seconds(self.arrays.commands if channel.ready else None, now)
            if stalled <= (self._seconds_allowed(channel) if channel.ready else BUILD_TIMEOUT):
                continue
            what = f"a reset or step took longer than {self._time_limit:g} s"
            hint = "or raise orchestrator.time_limit"
            if not channel.ready:
                what = f"building an environment took longer than {BUILD_TIMEOUT:g} s"
                hint = "or use fewer environments"
            self._lose(worker, worker.error(what, f"find out why it hangs, {hint}"), seconds=0.0)

    def _lose(self, worker: Worker, error: KarolosError | None = None, seconds: float = 1.0) -> None:
        """Stop a worker and report the failure of its environments. It has `seconds` to end by itself."""
        self._disconnect(worker)
        how = worker.end(seconds)  # the connection of a process closes shortly before the exit code is available
        worker.lost = error or worker.error(*how)
        self._any_lost = True
        self._failures.append(Failure(worker.environments, worker.lost, lost=error is None))

    def close(self) -> None:
        """End the workers."""
        alive = [worker for worker in self._workers if not worker.lost]
        hanging = self._hanging()
        for worker in alive:
            self._disconnect(worker)
        deadline = monotonic() + CLOSE_TIMEOUT
        for worker in alive:
            worker.end(0.0 if worker in hanging else max(0.0, deadline - monotonic()))
        self._workers = []

    def _hanging(self) -> list[Worker]:
        """The workers that do not answer a command, or are not built, within BUSY_TIMEOUT."""
        deadline = monotonic() + BUSY_TIMEOUT
        while busy := [one for one in self._channels if not one.worker.lost and one.busy]:
            answered = self._readable(0.0)
            hanging = [channel.worker for channel in busy if channel not in answered]
            if not hanging or monotonic() >= deadline:
                return hanging
            sleep(BUSY_TIMEOUT / 40)
        return []


def _widths(signature: Signature) -> tuple[object, ...]:
    """The facts that must be equal for environments in the same arrays."""
    goals = signature.achieved_goal, signature.desired_goal
    return (signature.observation, signature.action, *goals, signature.parameters, signature.measures)
