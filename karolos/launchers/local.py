"""Runs in processes of this machine. A process executes one run after another, so that it imports libraries once."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import subprocess
import sys
from pathlib import Path
from threading import Thread

from typing_extensions import override

from ..core.launcher import COMMAND, Ended, Launcher
from ..core.settings import Settings as BaseSettings
from ..errors import MachineError
from ..machine import cores


class Worker:
    """A process of this machine that executes runs, one at a time.

    It has a process group of its own, so that Ctrl-C in a terminal reaches only the process that decides what to do.
    """

    def __init__(self, cores: int) -> None:
        self.ready = False
        """Whether it has imported its libraries."""
        self.folder: Path | None = None
        """The run that it executes."""
        self.process = subprocess.Popen(
            [*COMMAND, "--cores", str(cores)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            process_group=0,
        )
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.orders, self.answers = self.process.stdin, self.process.stdout

    def start(self, folder: Path) -> None:
        self.folder = folder
        with contextlib.suppress(BrokenPipeError):  # its end is noticed at its answers
            self.orders.write(f"{folder}\n")

    def ended(self, answer: str) -> Ended | None:
        """What an answer means for its run; an empty one is the end of the process."""
        folder, self.folder = self.folder, None
        if not answer:
            return Ended(folder, f"its process {self.cause()}", died=True) if folder else None
        ready, self.ready = self.ready, True
        return Ended(folder, json.loads(answer)) if ready and folder else None

    def cause(self) -> str:
        """How the process ended, e.g. "was killed by signal 9"."""
        code = self.process.wait()
        return f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"


class Local(Launcher):
    """Processes of this machine: one for each of `jobs` runs at the same time.

    Raises:
        MachineError: from `wait`, if a process ends before it can execute a run.
    """

    class Settings(BaseSettings):
        pass

    def __init__(self, settings: Settings, jobs: int | None = None) -> None:  # noqa: ARG002  (it has none)
        self._jobs = jobs or 1
        self._workers: list[Worker] = []
        self._answers: queue.Queue[tuple[Worker, str]] = queue.Queue()

    @override
    def room(self, waiting: int) -> int:
        idle = [worker for worker in self._workers if worker.folder is None]
        for _ in range(min(self._jobs - len(self._workers), waiting - len(idle))):
            worker = Worker(cores(self._jobs))
            self._workers.append(worker)
            Thread(target=self._listen, args=(worker,), daemon=True).start()
        return sum(worker.ready for worker in idle)

    @override
    def start(self, folder: Path) -> None:
        next(worker for worker in self._workers if worker.ready and worker.folder is None).start(folder)

    @override
    def wait(self, seconds: float) -> Ended | None:
        try:
            worker, answer = self._answers.get(timeout=seconds)
        except queue.Empty:
            return None
        if not answer:
            self._workers.remove(worker)
            if not worker.ready:
                raise MachineError(f"a process of a run {worker.cause()} before it was ready", hint="see its output")
        return worker.ended(answer)

    @override
    def close(self, *, kill: bool) -> None:
        for worker in self._workers:
            worker.orders.close()  # which ends an idle process
            if kill:
                worker.process.kill()
            elif worker.folder is not None or not worker.ready:
                worker.process.terminate()
        for worker in self._workers:
            worker.process.wait()

    def _listen(self, worker: Worker) -> None:
        for answer in worker.answers:
            self._answers.put((worker, answer))
        self._answers.put((worker, ""))
