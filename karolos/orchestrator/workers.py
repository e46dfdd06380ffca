"""Environments in worker processes, seen from the parent: starting, asking, noticing deaths, ending."""

from __future__ import annotations

import pickle
import signal
from collections import deque
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from time import monotonic
from typing import Any

import numpy as np

from ..core import Signature
from ..errors import KarolosError, MachineError, PluginError, WorkerError
from .block import Block, SharedBytes
from .commands import Build, unpack_errors
from .crew import Answers, Crew, Ids
from .start import WorkerProcess, pack_recipe, start_worker
from .worker import DONE

PATIENCE = 3.0
"""Seconds that workers get to close their environments before they are killed."""


class _Lane:
    """The parent's view of one thread of a worker process."""

    def __init__(self, process: WorkerProcess, connection: Connection, ids: range) -> None:
        self.process = process
        self.connection = connection
        self.ids = ids
        self.under_way: deque[Ids] = deque()
        self.lost: WorkerError | None = None


class Workers(Crew):
    """Environments in worker processes. `layout` holds for each process the ids that each of its threads drives."""

    def __init__(self, build: Build, recipe: Any, layout: tuple[tuple[range, ...], ...]) -> None:
        self._size = sum(len(ids) for lanes in layout for ids in lanes)
        self._processes: list[WorkerProcess] = []
        self._lanes: list[_Lane] = []
        self._memory: SharedBytes | None = None
        try:
            self._start(pack_recipe(build, recipe), layout)
            self.signature = self._meet()
            self.block = self._share()
        except BaseException:  # also an interrupt while workers start: none may stay behind
            self.close()
            raise
        self._lane_of = np.repeat(np.arange(len(self._lanes)), [len(lane.ids) for lane in self._lanes])
        self._by_connection = {lane.connection: lane for lane in self._lanes}
        self._plans: dict[bytes, list[tuple[_Lane, Ids, bytes]]] = {}

    def _start(self, recipe: bytes, layout: tuple[tuple[range, ...], ...]) -> None:
        for number, ids in enumerate(layout):
            try:
                process, connections = start_worker(number, recipe, ids, self._size)
            except (OSError, EOFError) as error:
                raise MachineError(
                    f"worker process {number} of {len(layout)} does not start: {error}",
                    where="orchestrator",
                    hint="ask for fewer processes, or for 0 to step the environments in this process",
                ) from error
            self._processes.append(process)
            self._lanes.extend(_Lane(process, *lane) for lane in zip(connections, ids, strict=True))

    def _meet(self) -> Signature:
        """Wait until every lane has built its environments; the signature that they agree on."""
        signatures: dict[int, Signature] = {}
        waiting = {lane.connection: number for number, lane in enumerate(self._lanes)}
        while waiting:
            for connection in wait(list(waiting)):
                number = waiting.pop(connection)  # type: ignore[call-overload]
                message = _receive(self._lanes[number])
                if message is None:
                    raise self._lost(self._lanes[number])
                if message[:1] != DONE:
                    raise unpack_errors(message[1:])[0][1]
                signatures[number] = pickle.loads(message[1:])
        first = signatures[0]
        if any(_widths(signature) != _widths(first) for signature in signatures.values()):
            raise PluginError(
                "environments built from one recipe have different observations, goals or actions",
                where="orchestrator",
                hint="the environment's signature may depend on its settings only",
            )
        return first

    def _share(self) -> Block:
        self._memory = SharedBytes(Block.size(self.signature, self._size))
        for lane in self._lanes:
            with suppress(ConnectionError):  # a worker that has just died is found when something is asked of it
                self._memory.send(lane.connection, lane.process.pid or 0)
        return Block.over(self._memory.buffer, self.signature, self._size)

    def send(self, command: bytes, environments: Ids) -> None:
        key = environments.tobytes()
        plan = self._plans.get(key)
        if plan is None:
            if len(self._plans) >= 64:  # the usual sets are few; what ends episodes at random must not pile up
                self._plans.clear()
            plan = self._plans[key] = self._plan(environments)
        for lane, ids, message in plan:
            lane.under_way.append(ids)
            with suppress(OSError):  # `collect` finds the end of this worker, and says why it ended
                lane.connection.send_bytes(command + message)

    def _plan(self, environments: Ids) -> list[tuple[_Lane, Ids, bytes]]:
        """Which lane gets which of the environments, and that in a message's bytes."""
        lanes = self._lane_of[environments]
        plan = []
        for number in np.unique(lanes).tolist():
            ids = environments[lanes == number]
            plan.append((self._lanes[number], ids, ids.astype(np.uint32).tobytes()))
        return plan

    def collect(self) -> Answers:
        done: list[Ids] = []
        errors: list[tuple[int, KarolosError]] = []
        asked = [lane.connection for lane in self._lanes if lane.under_way]
        for connection in wait(asked):
            lane = self._by_connection[connection]  # type: ignore[index]
            message = None if lane.lost else _receive(lane)
            if message is None:
                lane.lost = lane.lost or self._lost(lane)
                errors.extend((index, lane.lost) for ids in lane.under_way for index in ids.tolist())
                lane.under_way.clear()
                continue
            ids = lane.under_way.popleft()
            if message[:1] != DONE:
                failed = unpack_errors(message[1:])
                errors.extend(failed)
                ids = np.setdiff1d(ids, [index for index, _ in failed])
            done.append(ids)
        return Answers.of(done, errors)

    @staticmethod
    def _lost(lane: _Lane) -> WorkerError:
        """The error that says how a lane's process ended."""
        lane.process.join(1.0)  # its connection closes a moment before its exit code can be read
        how, hint = _how_it_ended(lane.process.exitcode)
        ids = (
            f"environments {lane.ids.start} to {lane.ids.stop - 1}"
            if len(lane.ids) > 1
            else f"environment {lane.ids.start}"
        )
        return WorkerError(f"{how}, with {ids}", where=lane.process.name, hint=hint)

    def close(self) -> None:
        for lane in self._lanes:
            lane.connection.close()  # tells the worker to end
        deadline = monotonic() + PATIENCE
        for process in self._processes:
            process.join(max(0.0, deadline - monotonic()))
            if process.is_alive():
                process.kill()
                process.join()
        self._processes, self._lanes = [], []
        if self._memory is not None:
            self._memory.close()


def _receive(lane: _Lane) -> bytes | None:
    """The next message of a lane; None when there will be none."""
    try:
        return lane.connection.recv_bytes()
    except (EOFError, OSError):
        return None


def _how_it_ended(code: int | None) -> tuple[str, str]:
    if code is None:
        return "a thread of the worker ended", "standard error shows why"
    if code >= 0:
        return f"the worker process ended with exit code {code}", "the environment or a plugin has ended it"
    name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
    if name == "SIGKILL":
        return f"the worker process was killed by {name}", "if nobody did, memory ran out: use fewer environments"
    return f"the worker process was killed by {name}", "standard error shows where native code crashed"


def _widths(signature: Signature) -> tuple[object, ...]:
    return (
        signature.observation,
        signature.action,
        signature.achieved_goal,
        signature.desired_goal,
        signature.parameters,
    )
