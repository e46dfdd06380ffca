"""One run: one spec, one seed, from an empty folder to the end.

The loop around training and tests stands here; who writes down what happens is in `recording`, `series` and `keeping`.
"""

from __future__ import annotations

import traceback
from contextlib import ExitStack
from dataclasses import dataclass, field

from ..core import Agent, Buffer, Orchestrator
from ..core.schedules import Every
from ..core.seeding import SeedTree
from ..errors import KarolosError, WorkerError
from ..evaluation.testing import play_episodes, test_seeds
from ..records import RunFolder
from ..records.run_records import RunSummary
from ..spec import Spec
from ..store import Store
from ..training.assembly import make_agent, make_buffer, make_orchestrator
from ..training.demonstrations import collect_demonstrations
from ..training.training import Training
from .events import Listener, RunStarted
from .keeping import Keeper
from .recording import Recorder
from .resuming import Snapshot
from .scalars import Scalars
from .series import Series
from .signals import StopRequest
from .start_from import apply, find

SCALARS_PER_TEST = 10
"""Points of a training series between two tests."""


@dataclass
class Run:
    """Carries one seed of a spec from an empty folder to a finished run.

    Args:
        spec: what to run.
        seed: root of the run's random numbers.
        folder: the run's own, created and locked.
        store: the index to keep up to date.
        listener: is told what happens.
        stop: looked at between rounds.
        snapshot: where a run goes on that ended too soon; None: it begins.
    """

    spec: Spec
    seed: int
    folder: RunFolder
    store: Store
    listener: Listener
    stop: StopRequest
    snapshot: Snapshot | None = None
    _recorder: Recorder = field(init=False)
    _keeper: Keeper = field(init=False)

    def __post_init__(self) -> None:
        self._recorder = Recorder(self.folder, self.store, self.listener)
        self._keeper = Keeper(self._recorder, self.spec.hash(), self.seed)

    def execute(self) -> RunSummary:
        """Train, test, record. Whatever goes wrong is written down and told; other seeds can then go on."""
        folder = self.folder
        self.listener(RunStarted(folder.id, self.seed, self.spec.training.steps, str(folder.path)))
        error = trace = None
        try:
            self._recorder.state("running")
            if self.snapshot is None:
                folder.event("started")
            else:
                exact = self.spec.training.at_least is None
                steps = self.snapshot.meta["steps"]
                folder.event("resumed", attempt=folder.state().attempt, steps=steps, bit_exact=exact)
            self._train()
        except KeyboardInterrupt:
            self._recorder.state("stopped")
            folder.event("stopped", reason="SIGINT, at once")
            raise
        except KarolosError as problem:
            error, trace = str(problem), problem.traceback if isinstance(problem, WorkerError) else None
        except Exception as problem:  # the boundary: a fault of karolos or a plugin is recorded with its traceback
            error, trace = f"{type(problem).__name__}: {problem}", traceback.format_exc()
        if error is not None:
            self._recorder.failed(error, trace)
        return self._recorder.ended(error, trace)

    def _train(self) -> None:
        from ..agents.device import use_threads  # noqa: PLC0415  (imports torch)

        spec, seeds = self.spec, SeedTree(self.seed)
        use_threads(spec.training.threads or 1)
        with ExitStack() as stack:
            environments = stack.enter_context(make_orchestrator(spec, randomize=True))
            tests = stack.enter_context(make_orchestrator(spec, randomize=False))
            self.folder.event("layout", **environments.describe())
            signature, size = environments.signature, environments.size
            agent = make_agent(spec, signature, seeds)
            buffer = make_buffer(spec, signature, seeds, environments=size, discount=agent.discount)
            if self.snapshot is None or not self.snapshot.parts:
                self._start(agent)
                self._demonstrate(buffer, seeds)
            before = spec.demonstrations.updates if spec.demonstrations else 0
            training = Training(environments, agent, buffer, spec.training, seeds, spec.training.at_least, before)
            self._restore(training)
            scalars = Scalars(self.folder.tensorboard, purge=training.steps if self.snapshot else None)
            stack.callback(scalars.close)
            ended = self._loop(training, tests, Series(self._recorder, scalars, training))
        self._recorder.state(ended, training)
        reason = {"reason": self.stop.reason} if ended == "stopped" else {}
        self.folder.event(ended, steps=training.steps, **reason)

    def _start(self, agent: Agent) -> None:
        """Take over what another run's agent has learned, if the spec says so."""
        start = find(self.spec, self.folder.path.parent)
        if start is not None:
            apply(start, agent)
            self.folder.event("started_from", **start.record())

    def _demonstrate(self, buffer: Buffer, seeds: SeedTree) -> None:
        """Put the expert's episodes into the buffer, if the spec asks for some."""
        settings = self.spec.demonstrations
        if settings is None:
            return
        found = collect_demonstrations(self.spec.recipe(randomize=True), settings, seeds)
        buffer.add_demonstrations(found.episodes, settings.share)
        self.folder.event(
            "demonstrated",
            episodes=len(found.episodes),
            steps=found.steps,
            success_end=found.success_end,
            seconds=found.seconds,
        )

    def _restore(self, training: Training) -> None:
        """Go on where the snapshot says."""
        if self.snapshot is None:
            return
        parts, meta = self.snapshot.parts, self.snapshot.meta
        self.folder.cut_episodes(meta["episodes_bytes"])
        for warning in self.snapshot.warnings:
            self._recorder.warn(warning, "the run goes on from the checkpoint before")
        if not parts:
            self._recorder.warn("there is no checkpoint to go on from", "the run begins anew")
            return
        self._keeper.load(training, parts)

    def _loop(self, training: Training, tests: Orchestrator, series: Series) -> str:
        """Train and test to the end, or until somebody asks to stop; returns the state that the run ends in."""
        interval = self.spec.testing.interval
        test_due, series_due = Every(interval), Every(max(interval // SCALARS_PER_TEST, 1))
        for due in (test_due, series_due):
            due(training.steps)
        ended = "finished"
        for progress in training.rounds():
            series.note(progress)
            self._recorder.advanced(progress)
            testing = test_due(progress.steps)
            if series_due(progress.steps) or testing:
                series.report(training)
            if testing:
                self._test(training, tests, series)
            if self.stop.asked and training.steps < self.spec.training.steps:
                ended = "stopped"
                series.report(training)
                break
        if ended == "finished" and self._keeper.tested_at < training.steps:
            series.report(training)
            self._test(training, tests, series)
        self._keeper.keep(training)
        return ended

    def _test(self, training: Training, tests: Orchestrator, series: Series) -> None:
        settings = self.spec.testing
        result = play_episodes(
            tests,
            training.agent,
            test_seeds(settings.seed, settings.episodes),
            steps=training.steps,
            seconds=training.seconds,
            on_failure=self._recorder.replaced,
        )
        self._recorder.tested(result, training)
        series.test(result)
        self._keeper.tested(training, result)
        self._recorder.told(result)
