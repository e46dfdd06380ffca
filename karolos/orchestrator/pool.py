"""The pool of worker processes: starts them, sends commands, detects failures, replaces lost workers."""

from __future__ import annotations

import pickle
from contextlib import suppress
from time import monotonic
from typing import Any

import numpy as np

from ..core import Failure, Signature
from ..errors import KarolosError, MachineError, PluginError
from .backend import Answers, Backend, Group, Ids
from .channels import Channel, Poller, Worker
from .executor import RESET, STEP, Build
from .shared_memory import EnvironmentArrays, SharedBytes
from .start import pack_recipe
from .worker import DONE, packed

CLOSE_TIMEOUT = 3.0
"""Seconds for workers to close their environments before they are killed."""
BUILD_TIMEOUT = 300.0
"""Seconds for a worker to build its environments: the first import of a large library may take a minute."""
CHECK_INTERVAL = 1.0
"""Largest number of seconds between two checks for hanging workers."""


class WorkerPool(Backend):
    """Runs environments in worker processes. `layout` holds the ids of each thread's environments, by process.

    A worker that ends, or takes longer than `time_limit` seconds for one command, is a failure of all its environments.
    The next reset of one of them starts another worker. A worker that ends while it builds its environments for the
    first time is replaced at once, up to `failures` times.
    """

    def __init__(
        self, build: Build, recipe: Any, layout: tuple[tuple[range, ...], ...], time_limit: float, failures: int
    ) -> None:
        self._recipe = pack_recipe(build, recipe)
        self._layout = layout
        sizes = [len(ids) for channels in layout for ids in channels]
        self._size = sum(sizes)
        self._places = [(worker, channel) for worker, ranges in enumerate(layout) for channel in range(len(ranges))]
        """All pairs of worker and channel."""
        self._place_of = np.repeat(np.arange(len(sizes)), sizes)
        """The index in `_places` of each environment."""
        self._time_limit = time_limit
        self._check_interval = min(CHECK_INTERVAL, time_limit / 4)
        self._next_check = monotonic() + self._check_interval
        self._poller = Poller()
        self._memory: SharedBytes | None = None
        self._workers: list[Worker] = []
        self._any_lost = False
        self._undelivered: list[Failure] = []
        self._plans: dict[bytes, list[tuple[Channel, Group, dict[bytes, bytes]]]] = {}
        try:
            for number in range(len(layout)):
                self._workers.append(self._start(number))
            self._wait_until_ready(failures)
        except BaseException:  # also an interrupt, so that no worker stays behind
            self.close()
            raise

    def _start(self, number: int) -> Worker:
        try:
            worker = Worker(number, self._recipe, self._layout[number], self._size)
        except (OSError, EOFError) as error:
            raise MachineError(
                f"worker process {number} of {len(self._layout)} cannot be started: {error}",
                setting="orchestrator",
                hint="use fewer processes, or `processes: 0` to step environments in the main process",
            ) from error
        for channel in worker.channels:
            self._poller.add(channel)
        return worker

    def _wait_until_ready(self, failures: int) -> None:
        """Wait until every environment is built. Raises the error of building one, or of a worker that ends again."""
        losses = [0] * len(self._workers)
        while not all(channel.ready for worker in self._workers for channel in worker.channels):
            for failure in self.collect().failures:
                number = next((worker.number for worker in self._workers if worker.lost is failure.error), None)
                if number is None or losses[number] == failures:
                    raise failure.error
                losses[number] += 1
                self._workers[number] = self._start(number)
        self._any_lost = False

    def send(self, command: bytes, environments: Group) -> None:
        if self._any_lost and command == RESET:
            self._replace(environments.ids)
        key = environments.ids.tobytes()
        plan = self._plans.get(key)
        if plan is None:
            if len(self._plans) >= 64:  # bounds the memory where episodes end at random
                self._plans.clear()
            plan = self._plans[key] = self._plan(environments.ids)
        for channel, group, messages in plan:
            if channel.worker.lost:
                self._undelivered.append(Failure(group.ids, channel.worker.lost, lost=True))
            else:
                channel.send(messages[command], group)

    def _plan(self, environments: Ids) -> list[tuple[Channel, Group, dict[bytes, bytes]]]:
        """The channels of these environments, the environments of each, and the message for each command."""
        places = self._place_of[environments]
        plan = []
        for place in np.unique(places).tolist():
            worker, channel = self._places[place]
            ids = environments[places == place]
            messages = {command: packed(command, ids) for command in (RESET, STEP)}
            plan.append((self._workers[worker].channels[channel], Group.of(ids), messages))
        return plan

    def _replace(self, environments: Ids) -> None:
        """Replace the lost workers of these environments."""
        for number, _ in sorted({self._places[place] for place in self._place_of[environments]}):
            if self._workers[number].lost:
                with suppress(MachineError):  # the worker stays lost, and fails again
                    self._workers[number] = self._start(number)
        self._plans.clear()
        self._any_lost = any(worker.lost for worker in self._workers)

    def collect(self, *, wait: bool = True) -> Answers:
        answers = Answers([], self._undelivered)
        self._undelivered = []
        for channel in self._poller.poll(self._check_interval if wait and not answers.failures else 0.0):
            if not channel.worker.lost:  # an earlier channel of this worker may have reported its end
                self._read(channel, answers)
        now = monotonic()
        if now >= self._next_check:
            self._next_check = now + self._check_interval
            self._check_for_hangs(now, answers)
        return answers

    def _read(self, channel: Channel, answers: Answers) -> None:
        message = channel.receive()
        if message is None:
            self._lose(channel.worker, answers)
        elif not channel.ready:
            self._connect(channel, message, answers)
        elif message[:1] == DONE:
            answers.done.append(channel.pending.popleft())
        else:
            failed = pickle.loads(message[1:])
            answers.failures.extend(Failure(np.array([index]), error) for index, error in failed)
            answers.done.append(Group.of(np.setdiff1d(channel.pending.popleft().ids, [index for index, _ in failed])))

    def _connect(self, channel: Channel, message: bytes, answers: Answers) -> None:
        """Handle a channel's first message: the signature of its environments, or why they could not be built."""
        if message[:1] != DONE:
            self._lose(channel.worker, answers, pickle.loads(message[1:])[0][1])
            return
        signature: Signature = pickle.loads(message[1:])
        if self._memory is None:
            self.signature = signature
            self._memory = SharedBytes(EnvironmentArrays.size(signature, self._size))
            self.arrays = EnvironmentArrays.over(self._memory.buffer, signature, self._size)
        elif (error := differing(signature, self.signature)) is not None:
            self._lose(channel.worker, answers, error)
            return
        with suppress(ConnectionError):  # the poller reports a worker that has ended
            self._memory.send(channel.connection, channel.worker.process.pid or 0)
        channel.open()

    def _check_for_hangs(self, now: float, answers: Answers) -> None:
        for worker in self._workers:
            for channel in worker.channels if not worker.lost else []:
                limit = self._time_limit if channel.ready else BUILD_TIMEOUT
                if channel.stalled_seconds(self.arrays if self._memory else None, now) <= limit:
                    continue
                worker.process.kill()
                what, hint = f"a reset or step took longer than {limit:g} s", "or raise orchestrator.time_limit"
                if not channel.ready:
                    what, hint = f"building an environment took longer than {limit:g} s", "or use fewer environments"
                self._lose(worker, answers, worker.error(what, f"find out why it hangs, {hint}"))
                break

    def _lose(self, worker: Worker, answers: Answers, error: KarolosError | None = None) -> None:
        """Stop a worker and report the failure of its environments."""
        for channel in worker.channels:
            self._poller.remove(channel)
        worker.close_connections()
        worker.lost = worker.end()
        self._any_lost = True
        answers.failures.append(Failure(worker.environments, error or worker.lost, lost=error is None))

    def close(self) -> None:
        alive = [worker for worker in self._workers if not worker.lost]
        for worker in alive:
            worker.close_connections()
        deadline = monotonic() + CLOSE_TIMEOUT
        for worker in alive:
            worker.join(deadline)
        self._workers = []
        if self._memory is not None:
            self.arrays = EnvironmentArrays.private(self.signature, 0)  # a traceback may refer to the old arrays
            self._memory.close()


def differing(signature: Signature, other: Signature) -> PluginError | None:
    """The error of environments from one recipe that do not fit in the same arrays; None if they do."""
    if _widths(signature) == _widths(other):
        return None
    return PluginError(
        "environments from one recipe have different observations, goals or actions",
        setting="orchestrator",
        hint="an environment's signature must depend on its settings alone",
    )


def _widths(signature: Signature) -> tuple[object, ...]:
    goals = signature.achieved_goal, signature.desired_goal
    return (signature.observation, signature.action, *goals, signature.parameters)
