"""One run: one spec, one seed. Everything that touches disk around the training loop happens here.

The run folder is written first and is the truth; the store is told afterwards and can be rebuilt from it.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from . import checkpoint
from .assembly import make_agent, make_buffer, make_orchestrator
from .core import Orchestrator
from .errors import KarolosError, MachineError, RunError, StoreError, WorkerError
from .events import Listener, RunAdvanced, RunEnded, RunStarted, RunTested, RunWarned
from .run_folder import RunFolder
from .run_records import RunSummary
from .scalars import Means, Scalars
from .schedules import Every
from .seeding import SeedTree
from .signals import StopRequest
from .spec import Spec
from .store import Store
from .testing import TestResult, play_episodes, test_seeds
from .training import Episode, Progress, Training

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
    """

    spec: Spec
    seed: int
    folder: RunFolder
    store: Store
    listener: Listener
    stop: StopRequest
    _means: Means = field(default_factory=Means, init=False)
    _finished: list[Episode] = field(default_factory=list, init=False)
    _best: tuple[float, float] = field(default=(-1.0, -1.0), init=False)
    _tested_at: int = field(default=0, init=False)
    _told_at: float = field(default=0.0, init=False)

    def execute(self) -> RunSummary:
        """Train, test, record. Whatever goes wrong is written down and told; other seeds can then go on."""
        folder = self.folder
        self.listener(RunStarted(folder.id, self.seed, self.spec.training.steps, str(folder.path)))
        error = trace = None
        try:
            self._state("running")
            folder.event("started")
            self._train()
        except KeyboardInterrupt:
            self._state("stopped")
            folder.event("stopped", how="at once")
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
            signature, size = environments.signature, environments.size
            agent = make_agent(spec, signature, seeds)
            buffer = make_buffer(spec, signature, seeds, environments=size, discount=agent.discount)
            scalars = Scalars(self.folder.tensorboard)
            stack.callback(scalars.close)
            training = Training(environments, agent, buffer, spec.training, seeds)
            self._loop(training, tests, scalars)
        self._state("stopped" if self.stop.signal else "finished", training)
        self.folder.event("stopped" if self.stop.signal else "finished", steps=training.steps)

    def _loop(self, training: Training, tests: Orchestrator, scalars: Scalars) -> None:
        interval = self.spec.testing.interval
        test_due, scalars_due = Every(interval), Every(max(interval // SCALARS_PER_TEST, 1))
        for progress in training.rounds():
            self._note(progress)
            testing = test_due(progress.steps)
            if scalars_due(progress.steps) or testing:
                self._report(training, scalars)
            if testing:
                self._test(training, tests, scalars)
            if self.stop.signal:
                break
        else:
            if self._tested_at < training.steps:
                self._report(training, scalars)
                self._test(training, tests, scalars)
        self._checkpoint("last", training)

    def _note(self, progress: Progress) -> None:
        self._finished.extend(progress.finished)
        for metrics in progress.metrics:
            self._means.add(metrics)
        now = time.monotonic()
        if now - self._told_at >= ADVANCE_SECONDS:
            self._told_at = now
            warming_up = progress.episodes < self.spec.training.warmup_episodes
            self.listener(
                RunAdvanced(
                    self.folder.id, progress.steps, progress.updates, progress.episodes, progress.seconds, warming_up
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
            scalars.add("speed", _speeds(training), training.steps)
            scalars.add("train", _episode_means(episodes), training.steps)
            scalars.flush()

    def _test(self, training: Training, tests: Orchestrator, scalars: Scalars) -> None:
        settings = self.spec.testing
        seeds = test_seeds(settings.seed, settings.episodes)
        result = play_episodes(tests, training.agent, seeds, steps=training.steps, seconds=training.seconds)
        self._tested_at = training.steps
        self.folder.add_test(result)
        with self._tolerated(StoreError, "the test stands in the run folder, but not in the database"):
            self.store.add_test(self.folder.id, result)
        self._state("running", training)
        with self._tolerated(MachineError, "this test is missing in TensorBoard"):
            scalars.add("test", _test_means(result), training.steps)
            scalars.flush()
        self._checkpoint("last", training)
        merit = (result.success_end, result.success_any)
        if merit >= self._best:  # of equals the later one, which has learned longer
            self._best = merit
            self._checkpoint("best", training, result)
        self.listener(RunTested(self.folder.id, result))

    def _checkpoint(self, name: str, training: Training, result: TestResult | None = None) -> None:
        meta: dict[str, Any] = {
            "experiment": self.spec.hash(),
            "seed": self.seed,
            "steps": training.steps,
            "updates": training.updates,
            "seconds": training.seconds,
        }
        if result is not None:
            meta |= {"success_any": result.success_any, "success_end": result.success_end}
        with self._tolerated(MachineError, f"the checkpoint {name!r} was not written; the one before is kept"):
            checkpoint.save(self.folder.checkpoints, name, {"agent": training.agent.state()}, meta)

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
            self.folder.event("warning", error=str(error), consequence=consequence)
            self.listener(RunWarned(self.folder.id, f"{error} ({consequence})"))


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
    }


def _episode_row(episode: Episode, parameters: Sequence[str]) -> dict[str, Any]:
    """The episode as JSON values; what domain randomization drew stands under the parameters' names."""
    drawn = {"parameters": dict(zip(parameters, episode.parameters, strict=True))} if parameters else {}
    return {key: value for key, value in asdict(episode).items() if key != "parameters"} | drawn
