"""One run: one spec, one seed. Everything that touches disk around the training loop happens here.

The run folder is written first and is the truth; the store is told afterwards and can be rebuilt from it.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from . import checkpoint
from .assembly import make_agent, make_buffer, make_orchestrator
from .core import Agent, Buffer, Failure, Orchestrator, State
from .demonstrations import collect
from .episodes import Episode
from .errors import KarolosError, MachineError, RunError, StoreError, WorkerError
from .events import Listener, RunAdvanced, RunEnded, RunStarted, RunTested, RunWarned
from .progress import Progress
from .resuming import BEFORE, LAST, Snapshot
from .run_folder import RunFolder
from .run_records import RunSummary
from .scalars import Means, Scalars
from .schedules import Every
from .seeding import SeedTree
from .signals import StopRequest
from .spec import Spec
from .store import Store
from .testing import TestResult, play_episodes, test_seeds
from .training import Training
from .transfer import apply, find

ADVANCE_SECONDS = 0.1
"""How often a listener hears that the run has advanced."""
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
    _means: Means = field(default_factory=Means, init=False)
    _finished: list[Episode] = field(default_factory=list, init=False)
    _best: tuple[float, float] = field(default=(-1.0, -1.0), init=False)
    _tested_at: int = field(default=0, init=False)
    _kept_at: int = field(default=-1, init=False)
    _told_at: float = field(default=0.0, init=False)

    def execute(self) -> RunSummary:
        """Train, test, record. Whatever goes wrong is written down and told; other seeds can then go on."""
        folder = self.folder
        self.listener(RunStarted(folder.id, self.seed, self.spec.training.steps, str(folder.path)))
        error = trace = None
        try:
            self._state("running")
            if self.snapshot is None:
                folder.event("started")
            else:
                exact = self.spec.training.at_least is None
                steps = self.snapshot.meta["steps"]
                folder.event("resumed", attempt=folder.state().attempt, steps=steps, bit_exact=exact)
            self._train()
        except KeyboardInterrupt:
            self._state("stopped")
            folder.event("stopped", reason="SIGINT, at once")
            raise
        except KarolosError as problem:
            error, trace = str(problem), problem.traceback if isinstance(problem, WorkerError) else None
        except Exception as problem:  # the boundary: a fault of karolos or a plugin is recorded with its traceback
            error, trace = f"{type(problem).__name__}: {problem}", traceback.format_exc()
        if error is not None:
            self._state("failed", error=error.splitlines()[0])
            folder.event("failed", error=error, traceback=trace)
        summary = folder.summary()
        self.listener(RunEnded(folder.id, summary.state, error, trace))
        return summary

    def _train(self) -> None:
        from .agents.device import use_threads  # noqa: PLC0415  (imports torch)

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
            ended = self._loop(training, tests, scalars)
        self._state(ended, training)
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
        found = collect(self.spec.recipe(randomize=True), settings, seeds)
        buffer.keep(found.episodes, settings.share)
        self.folder.event(
            "demonstrated",
            episodes=len(found.episodes),
            steps=found.steps,
            success_end=found.success_ratio,
            seconds=found.seconds,
        )

    def _restore(self, training: Training) -> None:
        """Go on where the snapshot says."""
        if self.snapshot is None:
            return
        parts, meta = self.snapshot.parts, self.snapshot.meta
        self.folder.cut_episodes(meta["episodes_bytes"])
        for warning in self.snapshot.warnings:
            self._warn(warning, "the run goes on from the checkpoint before")
        if not parts:
            self._warn("there is no checkpoint to go on from", "the run begins anew")
            return
        training.agent.load_state(parts["agent"])
        training.buffer.load_state(parts["buffer"])
        training.load_state(parts["training"])
        own = parts["run"]
        self._best = (own["best_end"], own["best_any"])
        self._tested_at = own["tested_at"]

    def _loop(self, training: Training, tests: Orchestrator, scalars: Scalars) -> str:
        """Train and test to the end, or until somebody asks to stop; returns the state that the run ends in."""
        interval = self.spec.testing.interval
        test_due, scalars_due = Every(interval), Every(max(interval // SCALARS_PER_TEST, 1))
        for due in (test_due, scalars_due):
            due(training.steps)
        ended = "finished"
        for progress in training.rounds():
            self._note(progress)
            testing = test_due(progress.steps)
            if scalars_due(progress.steps) or testing:
                self._report(training, scalars)
            if testing:
                self._test(training, tests, scalars)
            if self.stop.asked and training.steps < self.spec.training.steps:
                ended = "stopped"
                self._report(training, scalars)
                break
        if ended == "finished" and self._tested_at < training.steps:
            self._report(training, scalars)
            self._test(training, tests, scalars)
        self._keep(training)
        return ended

    def _replaced(self, failure: Failure) -> None:
        named = ", ".join(map(str, failure.environment.tolist()))
        self._warn(str(failure.error), f"the episodes of these environments begin anew: {named}")

    def _note(self, progress: Progress) -> None:
        self._finished.extend(progress.finished)
        for metrics in progress.metrics:
            self._means.add(metrics)
        for failure in progress.failures:
            self._replaced(failure)
        now = time.monotonic()
        if now - self._told_at >= ADVANCE_SECONDS:
            self._told_at = now
            self.listener(
                RunAdvanced(
                    self.folder.id,
                    progress.steps,
                    progress.updates,
                    progress.episodes,
                    progress.seconds,
                    progress.warming_up,
                )
            )

    def _report(self, training: Training, scalars: Scalars) -> None:
        """Write down what happened since the last report; stop a run that has come to numbers that are none."""
        means = self._means.read()
        for name, value in means.items():
            if not np.isfinite(value):
                raise RunError(
                    f"{name} is {value} after {training.updates} updates ({training.steps} steps)",
                    where=self.folder.id,
                    hint="lower agent.learning_rate, or look at the rewards; the last checkpoint is kept",
                )
        episodes, self._finished = self._finished, []
        if episodes:
            names = training.orchestrator.signature.parameters.names
            self.folder.add_episodes(_episode_row(episode, names) for episode in episodes)
        with self._tolerated(MachineError, "these points are missing in TensorBoard"):
            scalars.add("agent", means, training.steps)
            scalars.add("buffer", training.buffer.metrics(), training.steps)
            scalars.add("speed", _speeds(training), training.steps)
            scalars.add("train", _episode_means(episodes), training.steps)
            scalars.flush()

    def _test(self, training: Training, tests: Orchestrator, scalars: Scalars) -> None:
        settings = self.spec.testing
        seeds = test_seeds(settings.seed, settings.episodes)
        result = play_episodes(
            tests,
            training.agent,
            seeds,
            steps=training.steps,
            seconds=training.seconds,
            on_failure=self._replaced,
        )
        self._tested_at = training.steps
        self.folder.add_test(result)
        with self._tolerated(StoreError, "the test stands in the run folder, but not in the database"):
            self.store.add_test(self.folder.id, result)
        self._state("running", training)
        with self._tolerated(MachineError, "this test is missing in TensorBoard"):
            scalars.add("test", _test_means(result), training.steps)
            scalars.flush()
        merit = (result.success_end, result.success_any)
        if merit >= self._best:  # of equals the later one, which has learned longer
            self._best = merit
            meta = {"success_any": result.success_any, "success_end": result.success_end}
            self._checkpoint("best", {"agent": training.agent.state()}, training, meta)
        self._keep(training)
        self.listener(RunTested(self.folder.id, result))

    def _keep(self, training: Training) -> None:
        """Write down all that the run needs to go on from here, bit for bit; the checkpoint before stays beside it."""
        if self._kept_at == training.steps:
            return
        self._kept_at = training.steps
        parts = {
            "agent": training.agent.state(),
            "buffer": training.buffer.state(),
            "training": training.state(),
            "run": {"best_end": self._best[0], "best_any": self._best[1], "tested_at": self._tested_at},
        }
        with self._tolerated(MachineError, "the checkpoint before is kept"):
            checkpoint.rename(self.folder.checkpoints, LAST, BEFORE)
        self._checkpoint(LAST, parts, training, {"episodes_bytes": self.folder.episodes_bytes()})

    def _checkpoint(self, name: str, parts: Mapping[str, State], training: Training, more: Mapping[str, Any]) -> None:
        meta = {
            "experiment": self.spec.hash(),
            "seed": self.seed,
            "steps": training.steps,
            "updates": training.updates,
            "seconds": training.seconds,
            **more,
        }
        with self._tolerated(MachineError, f"the checkpoint {name!r} was not written; the one before is kept"):
            checkpoint.save(self.folder.checkpoints, name, parts, meta)

    def _state(self, state: str, training: Training | None = None, error: str | None = None) -> None:
        if training is not None:
            self.folder.set_state(state, steps=training.steps, seconds=training.seconds, error=error)
        else:
            self.folder.set_state(state, error=error)
        with self._tolerated(StoreError, "the run goes on; its folder is complete"):
            self.store.update_run(self.folder.summary())

    @contextmanager
    def _tolerated(self, kind: type[KarolosError], consequence: str) -> Iterator[None]:
        """What must not end a run that can go on without it: say so, note it, go on."""
        try:
            yield
        except kind as error:
            self._warn(str(error), consequence)

    def _warn(self, warning: str, consequence: str) -> None:
        self.folder.event("warning", error=warning, consequence=consequence)
        self.listener(RunWarned(self.folder.id, f"{warning} ({consequence})"))


def _test_means(result: TestResult) -> dict[str, float]:
    return {
        "success_any": result.success_any,
        "success_end": result.success_end,
        "return": float(np.mean(result.returns)),
        "episode_length": float(np.mean(result.lengths)),
    }


def _episode_means(episodes: Sequence[Episode]) -> dict[str, float]:
    if not episodes:
        return {}
    return {
        "success_any": float(np.mean([episode.any for episode in episodes])),
        "success_end": float(np.mean([episode.end for episode in episodes])),
        "return": float(np.mean([episode.total_reward for episode in episodes])),
        "episode_length": float(np.mean([episode.steps for episode in episodes])),
        "diverged": float(np.mean([episode.diverged for episode in episodes])),
    }


def _speeds(training: Training) -> dict[str, float]:
    return {
        "steps_per_second": training.steps / training.seconds,
        "updates_per_second": training.updates / training.seconds,
        **training.lag.read(),
    }


def _episode_row(episode: Episode, parameters: Sequence[str]) -> dict[str, Any]:
    """The episode as JSON values; what domain randomization drew stands under the parameters' names."""
    drawn = {"parameters": dict(zip(parameters, episode.parameters, strict=True))} if parameters else {}
    return {key: value for key, value in asdict(episode).items() if key != "parameters"} | drawn
