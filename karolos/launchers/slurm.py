"""Runs as jobs of Slurm, submitted with sbatch as array jobs."""

from __future__ import annotations

import shlex
import subprocess
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import ClassVar

from pydantic import Field as Setting
from pydantic import ValidationInfo, field_validator
from typing_extensions import override

from ..core.settings import Settings as BaseSettings
from ..errors import MachineError, UsageError
from ..records.run_folder import LAUNCH, STOP
from ..system.files import read_object, write_whole
from .interface import COMMAND, Ended, Launcher

JOB = "slurm.job"
"""The file in a run's folder with the id of its job."""
PATIENCE_SECONDS = 600.0
"""Time for which squeue may fail. Its server is often unavailable for some minutes."""
GONE_SECONDS = 30.0
"""Time for which squeue does not know a job before the job counts as lost."""
OURS = ["-a", "--array", "-c", "--cpus-per-task", "-o", "--output", "--open-mode", "--signal", "--parsable"]
OURS += ["--requeue", "--no-requeue"]
MAYBE_OURS = {"gpus": ("-G", "--gpus"), "time": ("-t", "--time"), "partition": ("-p", "--partition")}
"""Options of sbatch that karolos sets always, and those that it sets with a setting of the launcher."""
ANSWER_SECONDS = 60.0
"""Time that a command of Slurm may take."""
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
    the same command with --resume follows them again. Their output is in the runs folder (.slurm-*.out). A run's folder
    says that the run has ended. squeue is only asked about jobs that died before they could write this.

    Raises:
        MachineError: a command of Slurm is missing, or squeue fails for minutes.
    """

    class Settings(BaseSettings):
        cpus: int = Setting(default=1, ge=1, description="cores of a run; two or more: tests run during training")
        gpus: int = Setting(default=0, ge=0, description="GPUs of a run")
        time: str | None = Setting(default=None, description="time limit of a job, as for sbatch, e.g. 4:00:00")
        partition: str | None = Setting(default=None, description="partition of Slurm; null: its default")
        options: tuple[str, ...] = Setting(default=(), description="more options of sbatch, e.g. --account=me")

        @field_validator("options")
        @classmethod
        def _leaves_ours_alone(cls, options: tuple[str, ...], given: ValidationInfo) -> tuple[str, ...]:
            """Refuse options that karolos sets: sbatch takes the last one, also by the beginning of its name."""
            ours = [*OURS, *(one for key, names in MAYBE_OURS.items() if given.data.get(key) for one in names)]
            for option in options:
                name = option.partition("=")[0]
                if option[:2] in ours or (name.startswith("--") and any(one.startswith(name) for one in ours)):
                    raise ValueError(f"karolos sets {name} itself: remove it here")
            return options

    poll_seconds: ClassVar[float] = 2.0

    def __init__(self, settings: Settings, jobs: int | None = None) -> None:
        self._settings, self._jobs = settings, jobs
        self._new: list[Path] = []
        self._active: dict[str, Path] = {}
        """Job id -> folder of its run."""
        self._missing: dict[str, float] = {}
        """Job id -> time since which squeue does not know the job."""
        _slurm("squeue", "--version")
        self._answered = time.monotonic()
        """When squeue last answered."""

    @override
    def room(self, waiting: int) -> int:
        return waiting if self._jobs is None else self._jobs - len(self._active) - len(self._new)

    @override
    def start(self, folder: Path) -> None:
        self._new.append(folder)

    @override
    def wait(self, seconds: float) -> Ended | None:
        states = self._states()
        if states is not None and self._new:
            self._submit(states)
        for name, folder in self._active.items():
            ended = (read_object(folder / LAUNCH) or {}).get("ended") or self._is_gone(name, states)
            if states is not None and states.get(name) == "PENDING" and (folder / STOP).exists():
                with suppress(MachineError):  # the next check tries again
                    _slurm("scancel", name)
                    ended = True
            if ended:
                del self._active[name]
                return Ended(folder, f"its job {name} ended, see .slurm-{name}.out in the runs folder", died=True)
        time.sleep(seconds)
        return None

    def _is_gone(self, name: str, states: dict[str, str] | None) -> bool:
        """Whether squeue has not known a job for a while. A single answer without the job may be wrong."""
        if states is None or name in states:
            self._missing.pop(name, None)
            return False
        return time.monotonic() - self._missing.setdefault(name, time.monotonic()) >= GONE_SECONDS

    @override
    def close(self, *, kill: bool) -> None:
        if self._active and kill:  # otherwise a later command follows them
            with suppress(MachineError):
                _slurm("scancel", *self._active)

    def _submit(self, states: Mapping[str, str]) -> None:
        """Submit the new runs as one array job, except those whose job from an earlier driver still exists."""
        for folder in list(self._new):
            job = folder / JOB
            if job.exists() and (name := job.read_text("utf-8").strip()) in states:
                self._active[name] = folder
                self._new.remove(folder)
        if not self._new:
            return
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
        number = next((line.partition(";")[0] for line in out.split() if line[:1].isdigit()), None)
        if number is None:
            hint = "`squeue --me` shows whether it has submitted the runs"
            raise MachineError(f"sbatch did not print the number of a job, but {out.strip()[:200]!r}", hint=hint)
        for task, folder in enumerate(self._new):
            self._active[f"{number}_{task}"] = folder
            write_whole(folder / JOB, f"{number}_{task}\n")
        self._new.clear()

    def _states(self) -> dict[str, str] | None:
        """The states of this user's jobs that have not ended. None while squeue fails; MachineError if it goes on."""
        try:
            out = _slurm("squeue", "--noheader", "--array", "--format=%i %T", "--me")
        except MachineError as error:
            if time.monotonic() - self._answered < PATIENCE_SECONDS:
                return None
            hint = "the jobs go on, and the same command with --resume follows them again"
            raise MachineError(
                f"squeue has failed for {PATIENCE_SECONDS / 60:g} minutes: {error.what}", hint=hint
            ) from error
        self._answered = time.monotonic()
        rows = (line.split() for line in out.splitlines())
        return {row[0]: row[1] for row in rows if len(row) == 2}  # other lines are messages


def _slurm(*command: str) -> str:
    """The output of a command of Slurm."""
    try:
        done = subprocess.run(
            command, capture_output=True, encoding="utf-8", errors="replace", check=False, timeout=ANSWER_SECONDS
        )
    except subprocess.TimeoutExpired as error:
        raise MachineError(f"{command[0]} did not answer within {ANSWER_SECONDS:g} s") from error
    except OSError as error:
        missing = isinstance(error, FileNotFoundError)
        what = f"{command[0]} is not installed" if missing else f"{command[0]} cannot be run: {error.strerror}"
        raise MachineError(what, hint="run on a machine that submits to Slurm") from error
    if done.returncode:
        told = "; ".join((done.stderr.strip() or done.stdout.strip()).splitlines())
        what = f"{command[0]} ended with exit code {done.returncode}" + (told and f": {told}")
        if command[0] == "sbatch":
            raise UsageError(what, hint="see launcher.* in the spec")
        raise MachineError(what)
    return done.stdout
