"""Environments in actors of a Ray cluster, for environments that are slow or bound to a machine."""

from __future__ import annotations

import importlib
import pickle
import signal
import socket
import sys
import threading
from contextlib import ExitStack
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Setting
from typing_extensions import override

from ..core import Failure
from ..environments.build import build_environment
from ..errors import KarolosError, MachineError
from .backend import Answers, Backend, Group
from .channels import worker_error
from .executor import FAILURES, RESET, Build, Executor, as_karolos_error, pack_errors
from .local import Limits, Local
from .pool import BUILD_TIMEOUT, CHECK_INTERVAL, CLOSE_TIMEOUT, differing
from .shared_memory import EnvironmentArrays
from .start import pack_recipe
from .worker import DONE, FAILED, NO_ENVIRONMENT, execute, packed

CONNECT_TIMEOUT = 10.0
"""Seconds for a cluster to accept a connection."""


def connect(address: str | None) -> tuple[Any, bool]:
    """The module `ray`, connected to the cluster at the address, and whether it was not connected before.

    Without an address to that in RAY_ADDRESS or on this machine; without any, it starts one on this machine.

    Raises:
        MachineError: Ray is not installed, or no cluster answers at the address.
    """
    try:
        ray: Any = importlib.import_module("ray")
    except ImportError as error:
        raise MachineError("Ray is not installed", hint="pip install 'karolos[ray]'") from error
    is_new = not ray.is_initialized()
    if is_new:
        on_terminate = signal.getsignal(signal.SIGTERM)
        try:
            host, _, port = (address or "").removeprefix("ray://").rpartition(":")
            if host:  # Ray would try for minutes
                socket.create_connection((host, int(port)), CONNECT_TIMEOUT).close()
            ray.init(address, log_to_driver=False, logging_level="ERROR", include_dashboard=None)
        except (OSError, RuntimeError, ValueError) as error:
            what = f"no Ray cluster answers at {address}" if address else "Ray does not start"
            hint = "`ray status` shows a cluster; one with a token needs RAY_AUTH_MODE=token"
            raise MachineError(f"{what}: {error}".splitlines()[0], hint=hint) from error
        # Ray prints errors of its own on stdout, where rows for other programs go.
        printer: Any = importlib.import_module("ray._private.worker")
        printer.print_to_stdstream = lambda *_, **__: None
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, on_terminate)  # Ray's handler would end this process at once
    return ray, is_new


class Ray(Local):
    """Environments in actors of a Ray cluster, spread over its machines: `workers` x `environments` (per worker).

    For environments whose steps take milliseconds, e.g. because they wait for another program or a licence server. A
    round takes one message per worker and about a millisecond; faster steps are faster with `local`. Actors reserve no
    cores of the cluster. Training and tests have actors of their own.

    Results are those of `local` with the same number of environments, which is the same experiment.
    """

    class Settings(Limits):
        workers: int = Setting(default=2, ge=1, le=64, description="actors, spread over the machines of the cluster")
        environments: int = Setting(default=4, ge=1, le=1024, description="environments per worker")
        address: str | None = Setting(
            default=None,
            description="HOST:PORT, ray://HOST:PORT, auto, or local to start one; null: the first there is",
        )

        @property
        def size(self) -> int:
            """Number of environments."""
            return self.workers * self.environments

        def identity(self) -> dict[str, Any]:
            """The settings that results depend on: those of a local orchestrator of this size."""
            return {"name": "local", "environments": self.size}

    def __init__(self, settings: Ray.Settings, recipe: Any, *, build: Build = build_environment) -> None:
        """Start the actors and wait until every environment is built.

        Raises:
            KarolosError: an environment cannot be built.
            MachineError: there is no Ray, or no cluster.
        """
        self._ray, _ = connect(settings.address)
        limits = settings.model_dump(include=set(Limits.model_fields))
        layout = Local.Settings(processes=settings.workers, environments=settings.environments, **limits)
        super().__init__(layout, recipe, build=build)

    @override
    def _start(self, build: Build, recipe: Any) -> Backend:
        ids = [channels[0] for channels in self._layout]
        return Actors(self._ray, pack_recipe(build, recipe), ids, self._settings)

    @override
    def describe(self) -> dict[str, Any]:
        return {"workers": len(self._layout), "environments": self.size}


class Environments:
    """The environments of one worker, which are those with the ids from `first`: runs in an actor."""

    def __init__(self, number: int, path: list[str], recipe: bytes, first: int, count: int) -> None:
        self._where = f"worker {number}"
        sys.path.extend(folder for folder in path if folder not in sys.path)  # as other worker processes have it
        self._recipe, self._first, self._count = recipe, first, count
        self._stack = ExitStack()

    def build(self) -> bytes:
        """Build the environments. The answer is as that of a worker process: their signature, or why not."""
        try:
            build, contents = pickle.loads(self._recipe)
            self._executor = Executor(build, contents, self._count, self._stack)
        except FAILURES as error:
            return FAILED + pack_errors([(NO_ENVIRONMENT, as_karolos_error(error, self._where))])
        self._arrays = EnvironmentArrays.private(self._executor.signature, self._first + self._count)
        self._executor.attach(self._arrays, self._first)
        return DONE + pickle.dumps(self._executor.signature)

    def execute(self, message: bytes, inputs: NDArray[Any]) -> tuple[bytes, list[NDArray[Any]]]:
        """Run the command of a message as a worker process does.

        Args:
            message: the command and the ids of its environments.
            inputs: their seeds or actions.

        Returns:
            The answer, and the rows of these environments in `_outputs`.
        """
        rows = np.frombuffer(message, np.uint32, offset=1)
        (self._arrays.seed if message[:1] == RESET else self._arrays.action)[rows] = inputs
        answer = execute(self._executor, message, self._where)
        return answer, [array[rows] for array in _outputs(self._arrays)]

    def close(self) -> None:
        self._stack.close()


class _Worker:
    """An actor and the ids of its environments."""

    def __init__(self, actor: Any, ids: range) -> None:
        self.actor, self.ids = actor, np.arange(ids.start, ids.stop)
        self.ready = False
        self.lost: KarolosError | None = None


class Actors(Backend):
    """Runs environments in actors. `ids` holds those of each actor. Failures are handled as by `WorkerPool`."""

    def __init__(self, ray: Any, recipe: bytes, ids: list[range], limits: Limits) -> None:
        self._ray, self._recipe, self._ids, self._limits = ray, recipe, ids, limits
        self._actor = ray.remote(Environments).options(num_cpus=0, scheduling_strategy="SPREAD")
        self._bounds = [part.stop for part in ids]
        self._pending: dict[Any, tuple[_Worker, Group | None, float]] = {}
        """Future answer -> worker, environments (None: it builds them), when it was sent (monotonic, s)."""
        self._undelivered: list[Failure] = []
        self._workers: list[_Worker] = []
        try:
            self._workers = [self._start(number) for number in range(len(ids))]
            losses = [0] * len(ids)
            while not all(worker.ready for worker in self._workers):
                for failure in self.collect().failures:
                    number = self._number(int(failure.environment[0]))
                    if not failure.lost or losses[number] == limits.failures:
                        raise failure.error
                    losses[number] += 1
                    self._workers[number] = self._start(number)
        except BaseException:  # also an interrupt, so that no actor stays behind
            self.close()
            raise

    def _start(self, number: int) -> _Worker:
        ids = self._ids[number]
        worker = _Worker(self._actor.remote(number, sys.path, self._recipe, ids.start, len(ids)), ids)
        self._pending[worker.actor.build.remote()] = worker, None, monotonic()
        return worker

    def _number(self, environment: int) -> int:
        """The number of the worker that has the environment."""
        return int(np.searchsorted(self._bounds, environment, side="right"))

    def send(self, command: bytes, environments: Group) -> None:
        numbers = np.searchsorted(self._bounds, environments.ids, side="right")
        for number in np.unique(numbers).tolist():
            group = Group.of(environments.ids[numbers == number])
            if self._workers[number].lost and command == RESET:
                self._workers[number] = self._start(number)
            worker = self._workers[number]
            if worker.lost:
                self._undelivered.append(Failure(group.ids, worker.lost, lost=True))
                continue
            inputs = (self.arrays.seed if command == RESET else self.arrays.action)[group.rows]
            self._pending[worker.actor.execute.remote(packed(command, group.ids), inputs)] = worker, group, monotonic()

    def collect(self, *, wait: bool = True) -> Answers:
        answers = Answers([], self._undelivered)
        self._undelivered = []
        if self._pending:
            timeout = CHECK_INTERVAL if wait and not answers.failures else 0.0
            self._ray.wait(list(self._pending), timeout=timeout)
            for answer in self._ray.wait(list(self._pending), num_returns=len(self._pending), timeout=0)[0]:
                if answer in self._pending:  # else its worker was lost by an earlier one
                    self._read(answer, answers)
        for worker, group, since in list(self._pending.values()):
            if group is None:
                what, limit = "building environments", BUILD_TIMEOUT
            else:
                what, limit = f"{group.ids.size} resets or steps", self._limits.time_limit * group.ids.size
            if not worker.lost and worker.ready is (group is not None) and monotonic() - since > limit:
                hint = "find out why it hangs, or raise orchestrator.time_limit"
                error = worker_error(f"{what} took longer than {limit:g} s", hint, self._name(worker), worker.ids)
                self._lose(worker, answers, error)
        return answers

    def _read(self, answer: Any, answers: Answers) -> None:
        worker, group, _ = self._pending.pop(answer)
        try:
            found = self._ray.get(answer)
        except self._ray.exceptions.RayError as error:
            self._lose(worker, answers, None, str(error).partition("\n")[0])
            return
        if group is None:
            if found[:1] != DONE:
                self._lose(worker, answers, pickle.loads(found[1:])[0][1])
                return
            worker.ready, signature = True, pickle.loads(found[1:])
            if not hasattr(self, "signature"):
                self.signature = signature
                self.arrays = EnvironmentArrays.private(signature, self._bounds[-1])
            elif (different := differing(signature, self.signature)) is not None:
                self._lose(worker, answers, different)
            now = monotonic()  # the time for commands that wait begins
            self._pending |= {
                one: (worker, sent, now) for one, (who, sent, _) in self._pending.items() if who is worker
            }
            return
        status, rows = found
        for array, values in zip(_outputs(self.arrays), rows, strict=True):
            array[group.rows] = values
        failed = [] if status[:1] == DONE else pickle.loads(status[1:])
        answers.failures.extend(Failure(np.array([index]), error) for index, error in failed)
        done = np.setdiff1d(group.ids, [index for index, _ in failed]) if failed else group.ids
        answers.done.append(Group.of(done))

    def _name(self, worker: _Worker) -> str:
        return f"worker {self._number(int(worker.ids[0]))}"

    def _lose(self, worker: _Worker, answers: Answers, error: KarolosError | None, cause: str = "") -> None:
        """Stop a worker and report the failure of its environments."""
        self._ray.kill(worker.actor)
        self._pending = {answer: one for answer, one in self._pending.items() if one[0] is not worker}
        worker.lost = error or worker_error(cause, "its machine or process was lost", self._name(worker), worker.ids)
        answers.failures.append(Failure(worker.ids, worker.lost, lost=error is None))

    def close(self) -> None:
        alive = [worker.actor for worker in self._workers if not worker.lost] if self._ray.is_initialized() else []
        closed = [actor.close.remote() for actor in alive]
        if closed:
            self._ray.wait(closed, num_returns=len(closed), timeout=CLOSE_TIMEOUT)
        for actor in alive:
            self._ray.kill(actor)
        self._workers = []


def _outputs(arrays: EnvironmentArrays) -> list[NDArray[Any]]:
    """What environments write."""
    return [arrays.parameters, *arrays.step]
