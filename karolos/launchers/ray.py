"""Runs as tasks of a Ray cluster."""

from __future__ import annotations

import platform
import socket
from pathlib import Path
from time import monotonic
from typing import Any, ClassVar

from pydantic import Field as Setting
from typing_extensions import override

from ..core.settings import Settings as BaseSettings
from ..errors import MachineError, UsageError
from ..orchestrator.ray import connect
from .interface import Ended, Launcher
from .local import RunProcess

CHECK_SECONDS, GONE_SECONDS = 5.0, 20.0
"""Time between two checks of the cluster, and time without an answer after which it counts as gone."""
BETWEEN = ("sh", "-c", '"$@"; exit', "run")
"""A process between a Ray worker and its run. The worker kills its children; the run can still write a checkpoint."""
_processes: list[RunProcess] = []
"""The process that executes the runs of this Ray worker, one after another."""


def hand_to_process(folder: str, cores: int) -> str | None:
    """Execute a run or a test in a Ray worker. Returns the reason if it could not be executed."""
    if not Path(folder).is_dir():
        return f"{platform.node()} cannot see {folder}; use a runs folder that all machines share under this path"
    if not _processes:
        _processes.append(RunProcess(cores, BETWEEN))
        _processes[0].answers.readline()  # libraries are imported
    process = _processes[0]
    process.ready = True
    process.start(Path(folder))
    ended = process.ended(process.answers.readline())
    assert ended is not None
    if ended.died:
        _processes.clear()
        raise ChildProcessError(ended.problem)
    return ended.problem


class RayLauncher(Launcher):
    """Tasks of a Ray cluster, each with its own cores and GPUs. Ray chooses the GPU.

    Without an address, and without a cluster in RAY_ADDRESS or on this machine, it starts one here. The runs folder is
    on a path that all machines share. A run whose machine or process is lost is resumed elsewhere.

    Raises:
        MachineError: Ray is not installed, there is no cluster at the address, or the cluster is gone.
        UsageError: no machine of the cluster has this number of cores or GPUs.
    """

    class Settings(BaseSettings):
        cpus: int = Setting(default=1, ge=1, description="cores of a run; two or more: tests run during training")
        gpus: float = Setting(default=0, ge=0, description="GPUs of a run; a fraction shares one")
        address: str | None = Setting(
            default=None,
            description="HOST:PORT, ray://HOST:PORT, auto, or local to start one; null: the first that exists",
        )
        max_retries: int = Setting(default=3, ge=0, description="resumptions of a run after its machine is lost")

    poll_seconds: ClassVar[float] = 0.5
    library = "ray"

    def __init__(self, settings: Settings, jobs: int | None = None) -> None:
        self._ray, self._mine = connect(settings.address)
        ray, self._jobs = self._ray, jobs
        for resource, amount in (("CPU", settings.cpus), ("GPU", settings.gpus)):
            most = max((node["Resources"].get(resource, 0) for node in ray.nodes() if node["Alive"]), default=0)
            if amount > most:
                self.close(kill=False)
                raise UsageError(
                    f"a run needs {amount:g} {resource}s, and no machine of the cluster has more than {most:g}",
                    setting=f"launcher.{resource.lower()}s",
                    hint="lower it, or add a larger machine",
                )
        options = {"num_cpus": settings.cpus, "num_gpus": settings.gpus, "max_retries": settings.max_retries}
        self._task = ray.remote(hand_to_process).options(**options, retry_exceptions=[ChildProcessError])
        self._cores = settings.cpus
        self._active: dict[Any, Path] = {}
        through_client = (settings.address or "").startswith("ray://")  # which raises a ConnectionError
        self._head: str | None = None if through_client else ray.get_runtime_context().gcs_address
        self._seen = monotonic()
        """When the head of the cluster last accepted a connection."""

    @override
    def room(self, waiting: int) -> int:
        return waiting if self._jobs is None else self._jobs - len(self._active)

    @override
    def start(self, folder: Path) -> None:
        self._active[self._task.remote(str(folder), self._cores)] = folder

    @override
    def wait(self, seconds: float) -> Ended | None:
        errors = self._ray.exceptions
        folder: Path | None = None
        try:
            done, _ = self._ray.wait(list(self._active), timeout=seconds) if self._active else ([], [])
            if not done:
                self._check_cluster()
                return None
            folder = self._active.pop(done[0])
            return Ended(folder, self._ray.get(done[0]))
        except errors.RayTaskError as error:  # of the task, e.g. karolos is not installed there
            assert folder is not None  # only getting its result raises this
            return Ended(folder, f"its task failed: {error.cause}")
        except (errors.RayError, ConnectionError) as error:
            if folder is None or isinstance(error, ConnectionError):  # e.g. of this machine's own part of the cluster
                raise self._gone() from error
            return Ended(folder, f"its machine or process was lost: {error}".splitlines()[0], died=True)

    def _check_cluster(self) -> None:
        """Raise a MachineError if the cluster is gone. Ray itself would end this process after a minute."""
        if self._head is None or monotonic() - self._seen < CHECK_SECONDS:
            return
        host, _, port = self._head.rpartition(":")
        try:
            socket.create_connection((host, int(port)), CHECK_SECONDS).close()
            self._seen = monotonic()
        except OSError as error:
            if monotonic() - self._seen > GONE_SECONDS:
                raise self._gone() from error

    def _gone(self) -> MachineError:
        self._active.clear()  # nothing can be cancelled
        return MachineError(
            "the Ray cluster is gone",
            where=self._head,
            hint="runs of living machines write checkpoints, and the same command with --resume continues",
        )

    @override
    def close(self, *, kill: bool) -> None:
        for task in self._active if hasattr(self, "_active") else ():
            self._ray.cancel(task, force=kill)
        if self._mine:
            self._ray.shutdown()
