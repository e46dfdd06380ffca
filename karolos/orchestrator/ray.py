"""Environments in actors of a Ray cluster, for environments that are slow or bound to a machine."""

from __future__ import annotations

import importlib
import signal
import socket
import sys
import threading
from collections import deque
from contextlib import ExitStack
from typing import Any

from numpy.typing import NDArray
from pydantic import Field as Setting
from typing_extensions import override

from ..core import BuildEnvironment, Signature
from ..errors import MachineError, UsageError
from .executor import RESET, EnvironmentArrays
from .local import Limits, Local
from .pool import Channel, Worker, WorkerPool
from .processes import pack_build
from .worker import build_environments, environments_in, run_command

CLIENT_PORT = 10001
"""Ray's port for ray://. Without the scheme Ray would try for hours to speak another protocol there."""
CONNECT_TIMEOUT = 10.0
"""Seconds for a cluster to accept a connection."""


def connect(address: str | None) -> tuple[Any, bool]:
    """The module `ray`, connected to the cluster at the address, and whether this call connected it.

    Without an address it connects to the cluster in RAY_ADDRESS or on this machine. If there is none, it starts one.

    Raises:
        MachineError: Ray is not installed, or no cluster answers at the address.
        UsageError: the address lacks its ray://.
    """
    host, _, port = (address or "").removeprefix("ray://").rpartition(":")
    if address == f"{host}:{CLIENT_PORT}":
        hint = f"ray://{address}, or HOST:PORT of the head (6379) on a machine of the cluster"
        raise UsageError(f"{address} is the port of Ray's clients", hint=hint)
    try:
        ray: Any = importlib.import_module("ray")
    except ImportError as error:
        raise MachineError("Ray is not installed", hint="pip install 'karolos[ray]'") from error
    is_new = not ray.is_initialized()
    if is_new:
        on_terminate = signal.getsignal(signal.SIGTERM)
        try:
            if host:  # Ray would try for minutes
                socket.create_connection((host, int(port)), CONNECT_TIMEOUT).close()
            ray.init(address, log_to_driver=False, logging_level="ERROR", include_dashboard=None)
        except (OSError, RuntimeError, ValueError) as error:
            what = f"no Ray cluster answers at {address}" if address else "Ray does not start"
            hint = "HOST:PORT (6379) is for machines of the cluster, and ray://HOST:PORT (10001) for others"
            hint += "; `ray status` shows a cluster; one with a token needs RAY_AUTH_MODE=token"
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

    library = "ray"

    class Settings(Limits):
        workers: int = Setting(default=2, ge=1, le=64, description="actors, spread over the machines of the cluster")
        environments: int = Setting(default=4, ge=1, le=1024, description="environments per worker")
        address: str | None = Setting(
            default=None,
            description="HOST:PORT, ray://HOST:PORT, auto, or local to start one; null: the first that exists",
        )

        @property
        def size(self) -> int:
            """Number of environments."""
            return self.workers * self.environments

        def identity(self) -> dict[str, Any]:
            """The settings that change results: those of a local orchestrator of this size."""
            return {"name": "local", "environments": self.size}

    def __init__(self, settings: Ray.Settings, build: BuildEnvironment) -> None:
        """Start the actors and wait until every environment is built.

        Raises:
            KarolosError: an environment cannot be built.
            MachineError: there is no Ray, or no cluster.
        """
        self._ray, _ = connect(settings.address)
        limits = settings.model_dump(include=set(Limits.model_fields))
        super().__init__(
            Local.Settings(processes=settings.workers, environments=settings.environments, **limits), build
        )

    @override
    def _start(self, build: BuildEnvironment) -> ActorPool:
        settings = self._settings
        return ActorPool(self._ray, pack_build(build), self._layout(), settings.time_limit, settings.failures)

    @override
    def describe(self) -> dict[str, Any]:
        return {"workers": self._settings.processes, "environments": self.size}


class Actor:
    """The environments of one worker, with ids from `first`, in an actor of Ray."""

    def __init__(self, number: int, path: list[str], packed_build: bytes, first: int, count: int) -> None:
        self._where = f"worker {number}"
        sys.path.extend(folder for folder in path if folder not in sys.path)  # as other worker processes have it
        self._build, self._first, self._count = packed_build, first, count
        self._stack = ExitStack()

    def build(self) -> bytes:
        """Build the environments. The answer is that of a worker process."""
        executor, answer = build_environments(self._build, self._count, self._stack, self._where)
        if executor is not None:
            self._arrays = EnvironmentArrays.private(executor.signature, self._first + self._count)
            executor.attach(self._arrays, self._first)
            self._executor = executor
        return answer

    def run(self, message: bytes, inputs: NDArray[Any]) -> tuple[bytes, list[NDArray[Any]]]:
        """Run the command of a message as a worker process does.

        Args:
            message: the command and the ids of its environments.
            inputs: their seeds or actions.

        Returns:
            The answer, and the rows of these environments in `_outputs`.
        """
        rows = environments_in(message)
        _inputs(self._arrays, message)[rows] = inputs
        answer = run_command(self._executor, message, self._where)
        return answer, [array[rows] for array in _outputs(self._arrays)]

    def close(self) -> None:
        self._stack.close()


class ActorPool(WorkerPool):
    """Runs environments in actors. Each has one channel, whose connection carries the rows of the arrays as well."""

    def __init__(
        self, ray: Any, packed_build: bytes, layout: list[list[range]], time_limit: float, failures: int
    ) -> None:
        self._ray, self._build = ray, packed_build
        self._actor = ray.remote(Actor).options(num_cpus=0, scheduling_strategy="SPREAD")
        super().__init__(layout, time_limit, failures)

    @override
    def _start(self, number: int) -> Worker:
        (ids,) = self._layout[number]
        actor = self._actor.remote(number, sys.path, self._build, ids.start, len(ids))
        connection = ActorConnection(self._ray, actor)
        return Worker(number, [connection], [ids], connection.end)

    @override
    def _allocate(self, signature: Signature) -> EnvironmentArrays:
        return EnvironmentArrays.private(signature, self._size)

    @override
    def _share(self, channel: Channel) -> None:
        channel.connection.arrays = self.arrays

    @override
    def _readable(self, timeout: float) -> list[Channel]:
        channels = [channel for channel in self._channels if not channel.worker.lost]
        oldest = {channel.connection.answers[0][0]: channel for channel in channels if channel.connection.answers}
        if not oldest or not self._ray.is_initialized():  # a script may have shut it down
            return []
        self._ray.wait(list(oldest), timeout=timeout)
        ready, _ = self._ray.wait(list(oldest), num_returns=len(oldest), timeout=0)
        return [oldest[answer] for answer in ready]

    @override
    def _seconds_allowed(self, channel: Channel) -> float:
        """An actor shows progress only when all environments of a command have completed it."""
        return self._time_limit * (channel.pending[0].ids.size if channel.pending else 1)


class ActorConnection:
    """An actor as a connection: a message is a call, and the next message from the actor is the oldest call's result.

    Args:
        ray: the module, connected.
        actor: an `Actor`, which begins to build its environments.
    """

    arrays: EnvironmentArrays
    """The parent's arrays: messages take rows from them, answers are written to them."""

    def __init__(self, ray: Any, actor: Any) -> None:
        self.ray, self.actor = ray, actor
        self.answers: deque[tuple[Any, bytes]] = deque([(actor.build.remote(), b"")])
        """Calls without a received result, oldest first: the future result and the message."""
        self.cause = ""
        """Why the connection has ended."""

    def send_bytes(self, message: bytes) -> None:
        inputs = _inputs(self.arrays, message)[environments_in(message)]
        self.answers.append((self.actor.run.remote(message, inputs), message))

    def recv_bytes(self) -> bytes:
        """The next answer. Raises EOFError if the actor is lost."""
        future, message = self.answers.popleft()
        try:
            found = self.ray.get(future)
        except self.ray.exceptions.RayError as error:
            self.cause = str(error).partition("\n")[0]
            raise EOFError(self.cause) from error
        answer, outputs = found if message else (found, [])
        for array, rows in zip(_outputs(self.arrays) if message else [], outputs, strict=True):
            array[environments_in(message)] = rows
        return bytes(answer)

    def close(self) -> None:
        """Let the actor close its environments after its pending calls."""
        self.answers.clear()
        if self.ray.is_initialized():
            self.answers.append((self.actor.close.remote(), b""))

    def end(self, seconds: float) -> tuple[str, str]:
        """As `Worker.end`."""
        if self.ray.is_initialized():
            self.ray.wait([answer for answer, _ in self.answers], timeout=seconds)
            self.ray.kill(self.actor)
        return self.cause, "its machine or process was lost"


def _inputs(arrays: EnvironmentArrays, message: bytes) -> NDArray[Any]:
    """The array that a message's environments read: seeds for a reset, else actions."""
    return arrays.seed if message[:1] == RESET else arrays.action


def _outputs(arrays: EnvironmentArrays) -> list[NDArray[Any]]:
    """The arrays that environments write."""
    return [arrays.parameters, arrays.measures, arrays.commands, *arrays.step]
