"""Environments in worker processes, seen from the parent: starting, asking, noticing deaths, replacing, ending."""

from __future__ import annotations

import pickle
from contextlib import suppress
from time import monotonic
from typing import Any

import numpy as np

from ..core import Failure, Signature
from ..errors import KarolosError, MachineError, PluginError
from .block import Block, SharedBytes
from .commands import RESET, STEP, Build, unpack_errors
from .crew import Answers, Crew, Group, Ids
from .lanes import Doorbells, Lane, Worker
from .start import pack_recipe
from .worker import DONE, packed

PATIENCE = 3.0
"""Seconds that workers get to close their environments before they are killed."""
BUILD_PATIENCE = 300.0
"""Seconds that a worker gets to build its environments: the first import of a large library may take a minute."""
LOOK_INTERVAL = 1.0
"""Seconds between two looks for workers that hang, at most."""


class Workers(Crew):
    """Environments in worker processes. `layout` holds for each process the ids that each of its threads drives.

    A worker that is gone, or hangs for longer than `time_limit` seconds in one command, is a failure of all its
    environments. The next reset of one of them starts another worker in its place.
    """

    def __init__(self, build: Build, recipe: Any, layout: tuple[tuple[range, ...], ...], time_limit: float) -> None:
        self._recipe = pack_recipe(build, recipe)
        self._layout = layout
        self._size = sum(len(ids) for lanes in layout for ids in lanes)
        self._time_limit = time_limit
        self._look_interval = min(LOOK_INTERVAL, time_limit / 4)
        self._next_look = monotonic() + self._look_interval
        self._doorbells = Doorbells()
        self._memory: SharedBytes | None = None
        self._workers: list[Worker] = []
        self._anything_lost = False
        self._undelivered: list[Failure] = []
        self._plans: dict[bytes, list[tuple[Lane, Group, dict[bytes, bytes]]]] = {}
        try:
            for number in range(len(layout)):
                self._workers.append(self._started(number))
            self._wait_until_ready()
        except BaseException:  # also an interrupt while workers start: none may stay behind
            self.close()
            raise
        threads = [len(lanes) for lanes in layout]
        self._worker_of = np.repeat(np.repeat(np.arange(len(layout)), threads), _lengths(layout))
        self._lane_of = np.repeat(np.concatenate([np.arange(count) for count in threads]), _lengths(layout))

    def _started(self, number: int) -> Worker:
        try:
            worker = Worker(number, self._recipe, self._layout[number], self._size)
        except (OSError, EOFError) as error:
            raise MachineError(
                f"worker process {number} of {len(self._layout)} does not start: {error}",
                where="orchestrator",
                hint="ask for fewer processes, or for 0 to step the environments in this process",
            ) from error
        for lane in worker.lanes:
            self._doorbells.add(lane)
        return worker

    def _wait_until_ready(self) -> None:
        while not all(lane.ready for worker in self._workers for lane in worker.lanes):
            for failure in self.collect().failures:
                raise failure.error

    def send(self, command: bytes, environments: Group) -> None:
        if self._anything_lost and command == RESET:
            self._replace(environments.ids)
        key = environments.ids.tobytes()
        plan = self._plans.get(key)
        if plan is None:
            if len(self._plans) >= 64:  # the usual sets are few; what ends episodes at random must not pile up
                self._plans.clear()
            plan = self._plans[key] = self._plan(environments.ids)
        for lane, group, messages in plan:
            if lane.worker.lost:
                self._undelivered.append(Failure(group.ids, lane.worker.lost))
            else:
                lane.send(messages[command], group)

    def _plan(self, environments: Ids) -> list[tuple[Lane, Group, dict[bytes, bytes]]]:
        """Which lane gets which of the environments, and the message for each command."""
        workers, lanes = self._worker_of[environments], self._lane_of[environments]
        plan = []
        for number, place in sorted(set(zip(workers.tolist(), lanes.tolist(), strict=True))):
            ids = environments[(workers == number) & (lanes == place)]
            messages = {command: packed(command, ids) for command in (RESET, STEP)}
            plan.append((self._workers[number].lanes[place], Group.of(ids), messages))
        return plan

    def _replace(self, environments: Ids) -> None:
        """Start another worker in place of each lost one that drives some of the environments."""
        for number in np.unique(self._worker_of[environments]).tolist():
            if self._workers[number].lost:
                with suppress(MachineError):  # the lost one stays, and fails again
                    self._workers[number] = self._started(number)
        self._plans.clear()
        self._anything_lost = any(worker.lost for worker in self._workers)

    def collect(self, *, wait: bool = True) -> Answers:
        answers = Answers([], self._undelivered)
        self._undelivered = []
        for lane in self._doorbells.rung(self._look_interval if wait and not answers.failures else 0.0):
            if not lane.worker.lost:  # another lane of the same worker may just have told of its end
                self._hear(lane, answers)
        now = monotonic()
        if now >= self._next_look:
            self._next_look = now + self._look_interval
            self._look_for_hangs(now, answers)
        return answers

    def _hear(self, lane: Lane, answers: Answers) -> None:
        message = lane.receive()
        if message is None:
            self._lose(lane.worker, answers)
        elif not lane.ready:
            self._meet(lane, message, answers)
        elif message[:1] == DONE:
            answers.done.append(lane.answered())
        else:
            failed = unpack_errors(message[1:])
            answers.failures.extend(Failure(np.array([index]), error) for index, error in failed)
            answers.done.append(Group.of(np.setdiff1d(lane.answered().ids, [index for index, _ in failed])))

    def _meet(self, lane: Lane, message: bytes, answers: Answers) -> None:
        """A lane's first message: the signature of the environments that it has built, or why it could not."""
        if message[:1] != DONE:
            self._lose(lane.worker, answers, unpack_errors(message[1:])[0][1])
            return
        signature: Signature = pickle.loads(message[1:])
        if self._memory is None:
            self.signature = signature
            self._memory = SharedBytes(Block.size(signature, self._size))
            self.block = Block.over(self._memory.buffer, signature, self._size)
        elif _widths(signature) != _widths(self.signature):
            error = PluginError(
                "environments built from one recipe have different observations, goals or actions",
                where="orchestrator",
                hint="the environment's signature may depend on its settings only",
            )
            self._lose(lane.worker, answers, error)
            return
        with suppress(ConnectionError):  # a worker that has just died is heard of soon
            self._memory.send(lane.connection, lane.worker.process.pid or 0)
        lane.open()

    def _look_for_hangs(self, now: float, answers: Answers) -> None:
        for worker in self._workers:
            for lane in worker.lanes if not worker.lost else []:
                limit = self._time_limit if lane.ready else BUILD_PATIENCE
                if lane.still_for(self.block if self._memory else None, now) <= limit:
                    continue
                worker.process.kill()
                what, hint = f"a reset or step took longer than {limit:g} s", "raise orchestrator.time_limit"
                if not lane.ready:
                    what, hint = f"building an environment took longer than {limit:g} s", "build less, or fewer"
                self._lose(worker, answers, worker.error(what, f"it hangs, or {hint}"))
                break

    def _lose(self, worker: Worker, answers: Answers, error: KarolosError | None = None) -> None:
        """The worker is gone, or as good as that: its environments have no episodes any more."""
        for lane in worker.lanes:
            self._doorbells.remove(lane)
        worker.hang_up()
        how = worker.end()
        worker.lost = how
        self._anything_lost = True
        answers.failures.append(Failure(worker.environments, error or how))

    def close(self) -> None:
        alive = [worker for worker in self._workers if not worker.lost]
        for worker in alive:
            worker.hang_up()
        deadline = monotonic() + PATIENCE
        for worker in alive:
            worker.free(deadline)
        self._workers = []
        if self._memory is not None:
            self.block = Block.private(self.signature, 0)  # unmaps the memory, which an error's frames may hold
            self._memory.close()


def _lengths(layout: tuple[tuple[range, ...], ...]) -> list[int]:
    return [len(ids) for lanes in layout for ids in lanes]


def _widths(signature: Signature) -> tuple[object, ...]:
    return (
        signature.observation,
        signature.action,
        signature.achieved_goal,
        signature.desired_goal,
        signature.parameters,
    )
