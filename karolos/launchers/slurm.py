"""Runs as jobs of Slurm, submitted with sbatch as array jobs."""

from __future__ import annotations

import shlex
import subprocess
import time
from pathlib import Path
from typing import ClassVar

from pydantic import Field as Setting
from typing_extensions import override

from ..core.settings import Settings as BaseSettings
from ..errors import MachineError, UsageError
from ..files import write_whole
from .interface import COMMAND, STOP, Ended, Launcher

JOB = "slurm.job"
"""The file in a run's folder with the id of its job."""
SCRIPT = """#!/bin/bash
# One line of {list} is the folder of this task's run. Before its time limit it writes a checkpoint and is queued again.
folder=$(sed -n "$((SLURM_ARRAY_TASK_ID + 1))p" {list})
{command} "$folder" &
run=$!
trap 'kill -USR1 $run' USR1
trap 'kill -TERM $run' TERM
while kill -0 $run 2>/dev/null; do wait $run; code=$?; done  # a trapped signal ends a wait
killed=$((128 + $(kill -l USR1)))  # before the run began
if [ "$code" = "$killed" ] || {{ [ "$code" = 0 ] && tail -n 1 "$folder/events.jsonl" | grep -q SIGUSR1; }}; then
    scontrol requeue "${{SLURM_ARRAY_JOB_ID}}_$SLURM_ARRAY_TASK_ID"
fi
"""


class SlurmLauncher(Launcher):
    """Jobs of Slurm. The runs folder is on a path that all machines share.

    A run that reaches its time limit writes a checkpoint and is queued again. Jobs stay when the driver's process ends:
    the same command with --resume follows them again. Their output is in the runs folder (.slurm-*.out).

    Raises:
        MachineError: a command of Slurm is missing or fails.
    """

    class Settings(BaseSettings):
        cpus: int = Setting(default=1, ge=1, description="cores of a run; with two or more, tests run beside training")
        gpus: int = Setting(default=0, ge=0, description="GPUs of a run")
        time: str | None = Setting(default=None, description="time limit of a job, as sbatch takes it, e.g. 4:00:00")
        partition: str | None = Setting(default=None, description="of Slurm; null: its default")
        options: tuple[str, ...] = Setting(default=(), description="further options of sbatch, e.g. --account=me")

    poll_seconds: ClassVar[float] = 2.0

    def __init__(self, settings: Settings, jobs: int | None = None) -> None:
        self._settings, self._jobs = settings, jobs
        self._new: list[Path] = []
        self._active: dict[str, Path] = {}
        """Job id -> folder of its run."""
        _slurm("squeue", "--version")

    @override
    def room(self, waiting: int) -> int:
        return waiting if self._jobs is None else self._jobs - len(self._active) - len(self._new)

    @override
    def start(self, folder: Path) -> None:
        job = folder / JOB
        if job.exists() and (name := job.read_text().strip()) in self._states([name]):
            self._active[name] = folder  # of a driver that has ended
        else:
            self._new.append(folder)

    @override
    def wait(self, seconds: float) -> Ended | None:
        if self._new:
            self._submit()
        states = self._states(list(self._active)) if self._active else {}
        for name, folder in self._active.items():
            if states.get(name) == "PENDING" and (folder / STOP).exists():
                _slurm("scancel", name)
            elif name in states:
                continue
            del self._active[name]
            return Ended(folder, f"its job {name} ended, see .slurm-{name}.out in the runs folder", died=True)
        time.sleep(seconds)
        return None

    @override
    def close(self, *, kill: bool) -> None:
        if self._active:
            _slurm("scancel", *([] if kill else ["--batch", "--signal=TERM"]), *self._active)

    def _submit(self) -> None:
        """Submit the new runs as one array job."""
        settings, runs = self._settings, self._new[0].parent
        stem = runs / f".slurm-{time.time_ns()}"
        write_whole(stem.with_suffix(".list"), "".join(f"{folder}\n" for folder in self._new))
        command = shlex.join([*COMMAND, "--cores", str(settings.cpus)])
        script = SCRIPT.format(list=shlex.quote(str(stem.with_suffix(".list"))), command=command)
        write_whole(stem.with_suffix(".sh"), script)
        options = {
            "array": f"0-{len(self._new) - 1}",
            "cpus-per-task": settings.cpus,
            "signal": "B:USR1@90",
            "open-mode": "append",
            "output": runs / ".slurm-%A_%a.out",
            "gpus": settings.gpus or None,
            "time": settings.time,
            "partition": settings.partition,
        }
        given = [f"--{name}={value}" for name, value in options.items() if value is not None]
        out = _slurm("sbatch", "--parsable", "--requeue", *given, *settings.options, str(stem.with_suffix(".sh")))
        number = out.strip().partition(";")[0]
        for task, folder in enumerate(self._new):
            self._active[f"{number}_{task}"] = folder
            write_whole(folder / JOB, f"{number}_{task}\n")
        self._new.clear()

    @staticmethod
    def _states(names: list[str]) -> dict[str, str]:
        """The states of those jobs that have not ended."""
        lines = _slurm("squeue", "--noheader", "--array", "--format=%i %T", "--me").splitlines()
        states = dict(line.split() for line in lines)
        return {name: states[name] for name in names if name in states}


def _slurm(*command: str) -> str:
    """The output of a command of Slurm."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except FileNotFoundError as error:
        raise MachineError(f"{command[0]} is not installed", hint="run on a machine that submits to Slurm") from error
    if done.returncode:
        refused = UsageError if command[0] == "sbatch" else MachineError
        first = next(iter((done.stderr.strip() or done.stdout.strip()).splitlines()), "it failed")
        raise refused(first, hint="see launcher.* in the spec")
    return done.stdout
