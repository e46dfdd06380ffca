"""The common part of sweeps, suites and matrices of transfers: they are run, stopped and resumed in the same way."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, ClassVar

from ..errors import RunError
from ..experiment.events import RunEvent, RunWarned
from ..experiment.signals import StopRequestedError, stop_on_signals
from ..launchers.driver import Driver, make_launcher
from ..launchers.experiment import Outcome
from ..launchers.runs import Existing, Home
from ..specification import Spec
from ..system.files import locked, write_whole, writing

PAGE = "report.html"
LOCK = "lock"
"""The file in a plan's folder that its process holds locked."""
LOCK_SECONDS = 0.5
"""Readers hold the lock for an instant to see whether the plan is running."""


class Plan(ABC):
    """Experiments that are run together and reported together.

    Their runs are ordinary runs, and the run folders say what is done: a stopped plan continues where it ended. `run`
    leaves its results in the plan.
    """

    what: ClassVar[str]
    """Word for this kind of plan."""
    place: ClassVar[str]
    """The folder of all such plans, in the runs folder."""
    name: str
    folder_name: str
    """Name of its own folder; usually that of the plan."""
    spec: Spec
    """The spec whose launcher is used."""
    jobs: int | None = None
    home: Home
    driver: Driver
    """These three are set by `run`."""

    def run(
        self,
        runs: str | Path = "runs",
        *,
        database: str | None = None,
        jobs: int | None = None,
        existing: Existing = "ignore",
        time_limit: float | None = None,
        listener: Callable[[Any], object] = lambda _: None,
        say: Callable[[str], object] = lambda _: None,
    ) -> Outcome:
        """Run all missing runs, and none twice.

        Arguments are those of `Experiment.run`. `jobs` counts trials in a sweep, which also always resumes. `say` is
        called with a line for each phase.

        Raises:
            SpecError, UsageError: the plan cannot work, or has begun and is not to be resumed.
            RunError: another process runs the plan, or what a run starts from is missing.
            MachineError: the runs folder cannot be written, or processes cannot be started.
            StoreError: the database cannot be used.
        """
        self.jobs, self.listener, self.say = jobs, listener, say
        complete = False
        with stop_on_signals(time_limit=time_limit) as stop, suppress(StopRequestedError), ExitStack() as stack:
            with stop.at_once():  # an environment may hang
                self.check()
            self.home = Home.prepared(self.spec, runs, database, existing)
            self.claim(stack)
            launcher = stack.enter_context(make_launcher(self.spec, self.at_once))
            self.driver = Driver(launcher, self.hear, stop, retries=1)
            complete = self.execute()
        return Outcome(complete, stop.exit_code)

    @property
    def at_once(self) -> int | None:
        """Processes at the same time; None: as many as the launcher has room for."""
        return self.jobs

    @property
    def folder(self) -> Path:
        return self.home.runs / self.place / self.folder_name

    @abstractmethod
    def check(self) -> None:
        """Raise an error if the plan cannot work, before anything runs. A stop request aborts the check."""

    @abstractmethod
    def execute(self) -> bool:
        """Run all missing runs. Returns whether the plan is complete."""

    def claim(self, stack: ExitStack) -> None:
        """Claim the plan, so that no other process runs it until the stack is left. Raises RunError."""
        refusal = RunError(f"another process runs this {self.what}", where=str(self.folder), hint="wait for it")
        stack.enter_context(locked(self.folder / LOCK, refusal, LOCK_SECONDS))

    def hear(self, event: RunEvent) -> None:
        self.listener(event)

    def warn(self, note: str) -> None:
        self.listener(RunWarned(self.name, note))

    def write_page(self, text: str) -> Path:
        """Write the plan's page into its folder; returns its path. Raises MachineError."""
        path = self.folder / PAGE
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, text)
        return path
