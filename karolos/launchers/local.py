"""Runs in processes of this machine. A process executes one run after another, and imports libraries only once."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from threading import Thread

from typing_extensions import override

from ..core.settings import Settings as BaseSettings
from ..errors import MachineError
from ..system import cores, ended_by, own_group
from .interface import COMMAND, Ended, Launcher

MOST_FAILED_STARTS = 3
"""Number of consecutive processes that may end before they are ready and are replaced."""


class RunProcess:
    """A process of this machine that executes runs, one at a time.

    It has a process group of its own, so that Ctrl-C in a terminal reaches only the process that decides what to do.
    `cores` are those of a run. The command line of the process begins with `command`.
    """

    def __init__(self, cores: int, command: Sequence[str] = ()) -> None:
        self.ready = False
        """Whether it has imported its libraries."""
        self.folder: Path | None = None
        """The run that it executes."""
        self.child = subprocess.Popen(
            [*command, *COMMAND, "--cores", str(cores)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            encoding="utf-8",
            bufsize=1,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            **own_group(),
        )
        assert self.child.stdin is not None
        assert self.child.stdout is not None
        self.orders, self.answers = self.child.stdin, self.child.stdout

    def start(self, folder: Path) -> None:
        self.folder = folder
        with contextlib.suppress(OSError):  # its end is noticed at its answers
            self.orders.write(f"{folder}\n")

    def ended(self, answer: str) -> Ended | None:
        """The meaning of an answer for its run; an empty answer is the end of the process."""
        folder, self.folder = self.folder, None
        if not answer:
            return Ended(folder, f"its process {self.cause()}", died=True) if folder else None
        ready, self.ready = self.ready, True
        return Ended(folder, json.loads(answer)) if ready and folder else None

    def cause(self) -> str:
        """How the process ended, e.g. "was killed by SIGKILL"."""
        code = self.child.wait()
        return f"was killed by {name}" if (name := ended_by(code)) else f"ended with exit code {code}"


class LocalLauncher(Launcher):
    """Processes of this machine: one for each of `jobs` runs at the same time.

    Raises:
        MachineError: from `wait`, if several processes in a row end before they can execute a run.
    """

    class Settings(BaseSettings):
        pass

    def __init__(self, settings: Settings, jobs: int | None = None) -> None:  # noqa: ARG002  (it has none)
        self._jobs = jobs or 1
        self._processes: list[RunProcess] = []
        self._failed_starts = 0
        """Number of consecutive processes that ended before they were ready."""
        self._answers: queue.Queue[tuple[RunProcess, str]] = queue.Queue()

    @override
    def room(self, waiting: int) -> int:
        idle = [process for process in self._processes if process.folder is None]
        for _ in range(min(self._jobs - len(self._processes), waiting - len(idle))):
            process = RunProcess(cores(self._jobs))
            self._processes.append(process)
            Thread(target=self._listen, args=(process,), daemon=True).start()
        return sum(process.ready for process in idle)

    @override
    def start(self, folder: Path) -> None:
        next(process for process in self._processes if process.ready and process.folder is None).start(folder)

    @override
    def wait(self, seconds: float) -> Ended | None:
        try:
            process, answer = self._answers.get(timeout=seconds)
        except queue.Empty:
            return None
        if not answer:
            self._processes.remove(process)
            self._failed_starts = 0 if process.ready else self._failed_starts + 1
            if self._failed_starts > MOST_FAILED_STARTS:
                raise MachineError(f"a process of a run {process.cause()} before it was ready", hint="see its output")
        return process.ended(answer)

    @override
    def close(self, *, kill: bool) -> None:
        for process in self._processes:
            with contextlib.suppress(OSError):  # it may have ended before it got its last order
                process.orders.close()  # which ends a run after a checkpoint
            if kill or process.folder is None:
                process.child.kill()
        for process in self._processes:
            process.child.wait()

    def _listen(self, process: RunProcess) -> None:
        for answer in process.answers:
            self._answers.put((process, answer))
        self._answers.put((process, ""))
