"""The driver starts the folders of jobs through a launcher, follows and stops them, and restarts them after a crash.

It knows nothing about processes, so they may be on other machines.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Literal

from .. import system
from ..errors import RunError, UsageError
from ..experiment.events import Listener, RunEvent
from ..experiment.signals import StopRequest
from ..experiment.tracking import Tracking
from ..records import provenance
from ..records.run_folder import LAUNCH, STOP
from ..registry import blaming
from ..specification import Spec
from ..system.files import read_object, write_json, write_whole
from .interface import Ended, Launcher
from .local import LocalLauncher


@blaming()
def make_launcher(spec: Spec, jobs: int | None) -> Launcher:
    """The spec's launcher, for `jobs` runs at the same time.

    Raises UsageError if `jobs` is below 1, PluginError if another package's launcher fails.
    """
    if jobs is not None and jobs < 1:
        raise UsageError(f"jobs is {jobs}, and must be at least 1", hint="give 1 or more")
    if spec.launcher is None:
        return LocalLauncher(LocalLauncher.Settings(), jobs)
    launcher: Launcher = spec.launcher.make(jobs)
    return launcher


class Job:
    """Tasks that are stopped together: the runs of a spec, or the zero-shot tests of a matrix."""

    together = False
    """Whether the failure of one task stops the others."""
    error: str | None = None
    """The error of the first task that failed."""
    halted: str | None = None
    """Why its tasks were stopped."""
    listed: Sequence[FolderTask] = ()
    """The job's tasks, if they are known before the driver takes the job."""

    def tasks(self) -> Iterable[FolderTask]:
        """The tasks to execute. Called once, when the driver takes the job."""
        return self.listed

    def heard(self, event: RunEvent) -> str | None:  # noqa: ARG002  (others do)
        """Called with each event of a task. Returns a reason to stop the job, or None."""
        return None

    def ended(self) -> None:
        """Called when all tasks are over."""


class FolderTask(ABC):
    """A folder that a process executes: a run, or a zero-shot test.

    A task is waiting, then active, then over. If its process died, it is waiting again.
    """

    job: Job
    path: Path
    """The folder, set by `begin`."""
    state: Literal["waiting", "active", "over"] = "waiting"
    deaths = 0
    """Number of its processes that died."""

    @abstractmethod
    def begin(self) -> Path:
        """Prepare the folder for a process, and return its path. Called before each start."""

    def events(self) -> Iterator[RunEvent]:
        """The events since the last call."""
        yield from ()

    @abstractmethod
    def is_over(self) -> bool:
        """Whether the task was complete when its process died."""

    @abstractmethod
    def end(self, problem: str | None) -> Iterator[RunEvent]:
        """Record the end and yield its events. `problem`: why the task did not end by itself."""


class Driver:
    """Executes the tasks of jobs through a launcher. After a stop request the runs write a checkpoint and end.

    `retries` is the number of restarts of a task whose process died.
    """

    def __init__(self, launcher: Launcher, listener: Listener, stop: StopRequest, retries: int = 0) -> None:
        self._launcher, self._listener, self.stop, self._retries = launcher, Tracking(listener), stop, retries
        self._work: dict[Job, list[FolderTask]] = {}
        """The current jobs, each with its tasks."""

    @blaming()
    def run(self, jobs: Iterable[Job], most: int | None = None) -> None:
        """Execute jobs. The next one is taken when fewer than `most` are active; None: all are taken at once.

        Raises PluginError if another package's launcher fails.
        """
        coming = iter(jobs)
        while True:
            # Take jobs, as long as no stop is requested.
            while not self.stop.requested and (most is None or len(self._work) < most):
                job = next(coming, None)
                if job is None:
                    break
                self._work[job] = list(job.tasks())
            if not self._work:
                return
            self._pass_stop_on()

            # Start tasks while the launcher has room.
            waiting = self._tasks("waiting")
            for task in waiting[: self._launcher.room(len(waiting))]:
                if task.state == "waiting":  # its job may have been halted by an event of the task before
                    self._start(task)

            # Read the folders, and look for processes that have ended.
            if self._tasks("waiting") or self._tasks("active"):
                ended = self._launcher.wait(self._launcher.poll_seconds)
                for task in self._tasks("active"):
                    self._tell(task, task.events())
                self._pass_stop_on()
                if ended is not None:
                    self._end(ended)

            # Finish the jobs whose tasks are over.
            for job in [job for job, tasks in self._work.items() if all(task.state == "over" for task in tasks)]:
                del self._work[job]
                job.ended()

    def _tasks(self, state: str) -> list[FolderTask]:
        return [task for tasks in self._work.values() for task in tasks if task.state == state]

    def _start(self, task: FolderTask) -> None:
        try:
            task.path = task.begin().resolve()
            system.remove(task.path / STOP, missing_ok=True)  # of an earlier process
            write_json(task.path / LAUNCH, provenance.software())
        except RunError as error:
            task.state = "over"
            self._tell(task, task.end(str(error)))
            return
        task.state = "active"
        self._launcher.start(task.path)
        self._tell(task, task.events())

    def _tell(self, task: FolderTask, events: Iterable[RunEvent]) -> None:
        for event in events:
            self._listener(event)
            reason = task.job.heard(event)
            if reason is not None:
                self._halt(task.job, reason)

    def _pass_stop_on(self) -> None:
        if self.stop.requested:
            for job in self._work:
                self._halt(job, self.stop.reason or "stopped")

    def _halt(self, job: Job, reason: str) -> None:
        """Stop the job's tasks: their processes read the reason in the file `stop`."""
        if job.halted:
            return
        job.halted = reason
        for task in self._work[job]:
            if task.state == "active":
                write_whole(task.path / STOP, reason)
            else:
                task.state = "over"

    def _end(self, ended: Ended) -> None:
        """Record the end of a task, or queue it again if its process died."""
        task = next(one for one in self._tasks("active") if one.path == ended.folder)
        self._tell(task, task.events())
        problem = ended.problem
        if (refusal := (read_object(ended.folder / LAUNCH) or {}).get("problem")) is not None:
            problem = str(refusal)  # another process would refuse, too
        elif ended.died and task.is_over():
            problem = None
        elif ended.died and not task.job.halted:
            task.deaths += 1
            if task.deaths <= self._retries:
                task.state = "waiting"
                return
            problem = f"{problem}, {task.deaths} times" if self._retries else problem
        task.state = "over"
        self._tell(task, task.end(problem))
        if task.job.together and task.job.error is not None:
            self._halt(task.job, "another run of this trial failed")
