"""The driver starts the folders of jobs through a launcher, follows them, stops them and starts again what died.

It knows nothing of processes, so that they may be on other machines.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Generic, TypeVar

from ..errors import RunError, UsageError
from ..experiment.events import Listener, RunEvent
from ..experiment.signals import StopRequest, stop_on_signals
from ..experiment.tracking import Tracking
from ..files import read_object, write_whole
from ..registry import load
from ..specification import Spec
from .interface import LAUNCH, STOP, Ended, Launcher
from .local import LocalLauncher


def make_launcher(spec: Spec, jobs: int | None) -> Launcher:
    """The spec's launcher, for so many runs at the same time. Raises UsageError if they are less than one."""
    if jobs is not None and jobs < 1:
        raise UsageError(f"jobs is {jobs}", hint="run at least one at a time")
    if spec.launcher is None:
        return LocalLauncher(LocalLauncher.Settings(), jobs)
    launcher: Launcher = load("launchers", spec.launcher.name)(spec.launcher.settings, jobs)
    return launcher


@contextmanager
def driving(spec: Spec, jobs: int | None, listener: Listener, time_limit: float | None) -> Iterator[Driver]:
    """A driver with the spec's launcher, which a signal or the time limit in seconds stops."""
    with stop_on_signals(time_limit=time_limit) as stop, make_launcher(spec, jobs) as launcher:
        yield Driver(launcher, listener, stop, retries=1)


class FolderTask(ABC):
    """A folder that a process executes: a run, or a zero-shot test."""

    deaths = 0
    """Processes that died."""

    @abstractmethod
    def begin(self) -> Path:
        """Make the folder ready for a process, and return its path. Called before each start."""

    def events(self) -> Iterator[RunEvent]:
        """What has happened since the last call."""
        yield from ()

    @abstractmethod
    def is_over(self) -> bool:
        """Whether it came to its end, although its process died."""

    @abstractmethod
    def end(self, problem: str | None) -> Iterator[RunEvent]:
        """Record the end and yield what it means. `problem`: why it has no end of its own."""


class Job:
    """Tasks that start and stop together."""

    together = False
    """Whether the failure of one task stops the others."""
    error: str | None = None
    """The error of the first task that failed."""
    halted: str | None = None
    """Why its tasks were stopped."""

    def tasks(self) -> Iterable[FolderTask]:
        """What there is to execute."""
        raise NotImplementedError


AnyJob = TypeVar("AnyJob", bound=Job)


class Feed(Generic[AnyJob]):
    """The source of a driver's jobs, which hears what happens to them. This one has a list of jobs."""

    def __init__(self, *jobs: AnyJob) -> None:
        self._jobs = deque(jobs)

    def next(self) -> AnyJob | None:
        """The next job to start; None if there is none at the moment."""
        return self._jobs.popleft() if self._jobs else None

    def heard(self, job: AnyJob, event: RunEvent) -> str | None:  # noqa: ARG002
        """Called with each event of a run. Returns a reason to stop the job's runs, or None."""
        return None

    def ended(self, job: AnyJob) -> None:
        """Called when no task of the job is active."""


class Driver:
    """Executes jobs through a launcher.

    Args:
        launcher: executes their tasks.
        listener: is called with every RunEvent.
        stop: after it is requested the runs end with a checkpoint.
        retries: how many times a task is started again after its process died.
    """

    def __init__(self, launcher: Launcher, listener: Listener, stop: StopRequest, retries: int = 0) -> None:
        self._launcher, self._listener, self.stop, self._retries = launcher, Tracking(listener), stop, retries
        self._waiting: deque[tuple[Job, FolderTask]] = deque()
        self._active: dict[Path, tuple[Job, FolderTask]] = {}

    def run(self, feed: Feed[Any]) -> None:
        """Run the feed's jobs until it has no more."""
        jobs: list[Job] = []
        while True:
            while not self.stop.requested and (job := feed.next()) is not None:
                jobs.append(job)
                self._waiting += [(job, task) for task in job.tasks()]
            if not jobs:
                return
            self._halt_all(jobs)
            for _ in range(min(self._launcher.room(len(self._waiting)), len(self._waiting))):
                job, task = self._waiting.popleft()
                try:
                    folder = task.begin().resolve()
                except RunError as error:
                    self._tell(job, task.end(str(error)), feed)
                    continue
                self._active[folder] = job, task
                self._launcher.start(folder)
                self._tell(job, task.events(), feed)
            if self._waiting or self._active:
                ended = self._launcher.wait(self._launcher.poll_seconds)
                for job, task in self._active.values():
                    self._tell(job, task.events(), feed)
                self._halt_all(jobs)
                if ended is not None:
                    self._end(ended, feed)
            busy = [job for job, _ in (*self._active.values(), *self._waiting)]
            for job in [job for job in jobs if job not in busy]:
                jobs.remove(job)
                feed.ended(job)

    def _tell(self, job: Job, events: Iterable[RunEvent], feed: Feed[Any]) -> None:
        for event in events:
            self._listener(event)
            reason = feed.heard(job, event)
            if reason is not None:
                self._halt(job, reason)

    def _halt_all(self, jobs: Iterable[Job]) -> None:
        """Stop all jobs if it is requested."""
        if self.stop.requested:
            for job in jobs:
                self._halt(job, self.stop.reason or "stopped")

    def _halt(self, job: Job, reason: str) -> None:
        """Stop the job's tasks: their processes read the reason in the file `stop`."""
        if job.halted:
            return
        job.halted = reason
        self._waiting = deque(one for one in self._waiting if one[0] is not job)
        for folder, (other, _) in self._active.items():
            if other is job:
                write_whole(folder / STOP, reason)

    def _end(self, ended: Ended, feed: Feed[Any]) -> None:
        """Record the end of a task, or start it again if its process died."""
        job, task = self._active[ended.folder]
        self._tell(job, task.events(), feed)
        del self._active[ended.folder]
        problem = ended.problem
        if (refusal := (read_object(ended.folder / LAUNCH) or {}).get("problem")) is not None:
            problem = str(refusal)  # another process would refuse as well
        elif ended.died and task.is_over():
            problem = None
        elif ended.died and not job.halted:
            task.deaths += 1
            if task.deaths <= self._retries:
                self._waiting.appendleft((job, task))
                return
            problem = f"{problem}, {task.deaths} times" if self._retries else problem
        self._tell(job, task.end(problem), feed)
        if job.together and job.error is not None:
            self._halt(job, "another run of this trial failed")
