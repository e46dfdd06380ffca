"""One run: one spec, one seed, from an empty folder to the end.

Run prepares training, alternates it with tests, writes everything down and then tells the listener.
"""

from __future__ import annotations

import traceback
from contextlib import ExitStack
from dataclasses import dataclass, field, replace

from ..core.schedules import Every
from ..core.seeding import SeedTree
from ..errors import KarolosError, MachineError, RunError, WorkerError, described
from ..evaluation.due_tests import DueEvaluation
from ..evaluation.testing import test_seeds
from ..records import RunFolder, checkpoint
from ..records.checkpoint import CheckpointError
from ..records.evaluation import Evaluation
from ..records.run_records import RunSummary
from ..registry import blamed
from ..specification import Spec, spec_from_dict
from ..specification.model import DemonstrationSettings
from ..training.assembly import learner, make_agent, make_buffer, make_orchestrator, use_threads
from ..training.collecting import Episode
from ..training.demonstrations import collect_demonstrations
from ..training.training import Training
from .checkpointer import BEST, Checkpointer
from .events import Listener, RunEnded, RunFinalTested, RunStarted, RunTested
from .pending_tests import PendingTests
from .resume import LAST, Snapshot, check_files, newest_snapshot
from .signals import StopRequest, StopRequestedError
from .start_from import apply, find
from .tensorboard_writer import TensorBoardWriter
from .writer import Ending, RunWriter

REPORTS_PER_TEST = 10
JUDGED_EPISODES = 20
"""Smallest number of training episodes whose share of divergence is judged before the end of training."""
DIVERGING = 0.01
"""Share of diverged training episodes above which a run warns."""


@dataclass
class Run:
    """Carries one seed of a spec from an empty folder to a finished run."""

    spec: Spec
    seed: int
    folder: RunFolder
    """Created and locked."""
    url: str | None
    """SQLAlchemy URL of the results database; None: another process indexes the run."""
    listener: Listener
    stop: StopRequest
    """Is checked after each round."""
    snapshot: Snapshot | None = None
    """Where an unfinished run resumes; None: the run starts."""
    two_processes: bool = False
    """Whether a second process may play tests while this one trains."""
    _pending: list[DueEvaluation] = field(default_factory=list, init=False)
    """Tests without a recorded result."""

    def __post_init__(self) -> None:
        self._writer = RunWriter(self.folder, self.url, self.listener)
        self._checkpointer = Checkpointer(self._writer, self.spec, self.seed, self._pending)

    def execute(self) -> RunSummary:
        """Train, test and record. An error ends only this run: it is recorded, and other seeds can run."""
        self.listener(RunStarted(self.folder.id, self.seed, self.spec.training.steps, str(self.folder.path)))
        try:
            self._writer.start(self.snapshot, learner(self.spec), exact=self.spec.training.at_least is None)
            ending = self._train()
        except KeyboardInterrupt:
            self._end(Ending("stopped", reason=f"{self.stop.reason or 'KeyboardInterrupt'}, at once"))
            raise
        except StopRequestedError:  # something was aborted; the checkpoints are unchanged
            ending = Ending("stopped", reason=self.stop.reason)
        except KarolosError as error:
            trace = error.traceback if isinstance(error, WorkerError) else None
            ending = Ending("failed", error=str(error), traceback=trace)
        except (Exception, SystemExit) as error:  # the boundary: a fault of karolos or a plugin is recorded
            ending = Ending("failed", error=str(blamed(error) or described(error)), traceback=traceback.format_exc())
        self._end(ending)
        return self.folder.summary()

    def _end(self, ending: Ending) -> None:
        try:
            self._writer.end(ending)
        except MachineError as error:  # e.g. the disk is full
            error.hint = f"{error.hint or ''}; `karolos resume` then continues from the newest checkpoint".lstrip("; ")
            raise
        self.listener(RunEnded(self.folder.id, ending.state, ending.error, ending.traceback))

    def _train(self) -> Ending:
        spec, seeds = self.spec, SeedTree(self.seed)
        use_threads(spec)
        with ExitStack() as stack:
            self._tensorboard = TensorBoardWriter(self.folder.tensorboard, self._writer, self.snapshot)
            stack.callback(self._tensorboard.close)
            with self.stop.at_once():
                environments = stack.enter_context(make_orchestrator(spec, randomize=True))
                signature, size = environments.signature, environments.size
                agent = make_agent(spec, signature, seeds)
                buffer = make_buffer(spec, signature, seeds, environments=size, discount=agent.discount)
            self.folder.event("layout", **environments.describe())
            pretraining_updates = spec.demonstrations.updates if spec.demonstrations else 0
            training = Training(
                environments, agent, buffer, spec.training, seeds, spec.training.at_least, pretraining_updates
            )
            self._writer.training = training
            tests = PendingTests(
                spec, training, self._pending, self._writer, self.stop, two_processes=self.two_processes
            )
            stack.callback(tests.close)
            finished = self._prepare(training) and self._train_and_test(training, tests)
            finished = finished and self._final_test(training, tests)
            if finished:
                self._checkpointer.require(training)
        if finished and not training.updates:
            started = getattr(spec.agent.settings, "start_from", None)
            policy = f"what it started from, {started}" if started else "that of an untrained agent"
            self._writer.warn("the run made no gradient update", f"its policy is {policy}")
        totals = training.totals()
        return Ending("finished", totals) if finished else Ending("stopped", totals, self.stop.reason)

    def _prepare(self, training: Training) -> bool:
        """Start or resume, and collect missing demonstrations. Returns False if a stop is requested."""
        resumes = self.snapshot is not None and bool(self.snapshot.parts)
        if self.snapshot is not None:
            self._resume(training, self.snapshot)
        if not resumes:
            if self.spec.continued_from is not None:
                hint = "`karolos resume RUN training.steps=...` makes such a run"
                raise RunError("it has no checkpoint of the run that it continues", where=self.folder.id, hint=hint)
            start = find(self.spec, self.folder.path.parent)
            if start is not None:
                apply(start, training.agent)
                self.folder.event("started_from", **start.record())
            self._checkpointer.demonstrated = self.spec.demonstrations is None
        try:
            if self.spec.demonstrations is not None and not self._checkpointer.demonstrated:
                self._demonstrate(training, self.spec.demonstrations)
                self._checkpointer.demonstrated = True
        except StopRequestedError:
            self._checkpointer.save(training)
            return False
        return True

    def _demonstrate(self, training: Training, settings: DemonstrationSettings) -> None:
        """Add the expert's episodes to the buffer. Raises StopRequestedError."""

        def on_step(episodes: int) -> None:
            self.stop.check()
            self._writer.announce("collecting demonstrations", episodes, settings.episodes)

        recipe = self.spec.recipe(randomize=True)
        with self.stop.at_once():
            demonstrations = collect_demonstrations(recipe, settings, training.seeds, on_step)
        self._writer.announce("collecting demonstrations", settings.episodes, settings.episodes)
        training.buffer.add_demonstrations(demonstrations.episodes, settings.share)
        training.seconds += demonstrations.seconds
        self.folder.event(
            "demonstrated",
            episodes=len(demonstrations.episodes),
            steps=demonstrations.steps,
            success_end=demonstrations.success_end,
            seconds=demonstrations.seconds,
        )

    def _resume(self, training: Training, snapshot: Snapshot) -> None:
        for warning in snapshot.warnings:
            self._writer.warn(warning, "the run resumes from the previous checkpoint")
        if snapshot.parts:
            with self.stop.at_once():
                self._pending += self._checkpointer.restore(training, snapshot.parts)
            self._checkpointer.last_is_whole = snapshot.checkpoint == LAST
            snapshot.parts.clear()  # the run takes hours, and the buffer shall not be in memory twice
        else:
            self._writer.warn("the run has no checkpoint", "it begins again")

    def _train_and_test(self, training: Training, tests: PendingTests) -> bool:
        """Train and test until all is done or a stop is requested. Returns whether all is done."""
        interval = self.spec.testing.interval
        test_due, report_due = Every(interval), Every(max(interval // REPORTS_PER_TEST, 1))
        for due in (test_due, report_due):
            due(training.steps)
        reported_at = -1
        episodes: list[Episode] = []
        tests.catch_up()  # after a stop some are pending
        diverged = self._checkpointer.diverged
        for progress in training.rounds():
            episodes += progress.finished
            diverged += (episode.diverged for episode in progress.finished)
            for failure in progress.failures:
                self._writer.warn_of_failure(failure)
            self._writer.progressed(progress, last=training.over)
            testing = test_due(progress.steps) or training.over
            if report_due(progress.steps) or testing:
                self._report(training, episodes)
                episodes, reported_at = [], training.steps
            if testing and (len(diverged) >= JUDGED_EPISODES or training.over):
                self._judge(diverged, progress.steps)
                diverged.clear()
            self._test(training, tests, due=testing)
            if reported_at == training.steps:
                self._checkpointer.reported(training)
            if self.stop.requested:
                break
        if reported_at < training.steps:
            self._report(training, episodes)
        if training.over:
            for test, result in tests.play_remaining():
                self._tested(training, test, result)
        self._checkpointer.save(training)
        if tests.pending and self.stop.reason != "pruned":  # such a trial cannot be resumed
            late = ", ".join(f"{test.steps:,}" for test in tests.pending)
            self._writer.warn(f"no test was played after {late} steps, where it is due", "a resumed run plays it")
        return training.over and not tests.pending

    def _judge(self, diverged: list[bool], steps: int) -> None:
        """Record the number of diverged episodes. Raises RunError if the spec does not allow this share."""
        if not (count := sum(diverged)):
            return
        self.folder.event("diverged", steps=steps, episodes=len(diverged), diverged=count)
        what = f"{count} of {len(diverged)} training episodes diverged until {steps} steps"
        if count > len(diverged) * self.spec.training.diverging:
            hint = "numbers are not finite or an object is far away: check the environment, or allow more of them"
            raise RunError(what, setting="training.diverging", hint=hint)
        if count >= len(diverged) * DIVERGING:
            self._writer.warn(what, "the agent does not learn from their last steps")

    def _report(self, training: Training, episodes: list[Episode]) -> None:
        """Report episodes and metrics of the agent since the last report. Raises RunError if a metric is not finite."""
        metrics = training.read_metrics()
        self._writer.write_episodes(episodes, training.orchestrator.signature.parameters.names)
        self._tensorboard.add_report(training, episodes, metrics)

    def _test(self, training: Training, tests: PendingTests, *, due: bool) -> None:
        """Add a test if one is due, and record finished tests."""
        tests.advance()
        if due:
            tests.add()
        for test, result in tests.finished():
            self._tested(training, test, result)
        if due and tests.pending:
            self._checkpointer.save(training)

    def _tested(self, training: Training, test: DueEvaluation, result: Evaluation) -> None:
        self._writer.write_test(training, result)
        self._tensorboard.add_test(result)
        self._checkpointer.tested(training, test, result)
        self.listener(RunTested(self.folder.id, result))

    def _final_test(self, training: Training, tests: PendingTests) -> bool:
        """Play the final test, if the spec has one. Returns False if a stop is requested before it is complete."""
        settings, folder = self.spec.testing, self.folder.checkpoints
        if not settings.final_count:
            return True
        seeds = test_seeds(settings.final_seed, settings.final_count)
        last = DueEvaluation(training.steps, training.updates, training.seconds, training.agent.state(), seeds)
        best, last_sha256, best_sha256 = None, "", None
        with self._writer.tolerated(CheckpointError, "the final test does not say which checkpoint was `last`"):
            last_sha256 = checkpoint.digest(folder, LAST, "agent")
        with self._writer.tolerated(CheckpointError, "the final test of this checkpoint is missing"):
            agent, meta, best_sha256 = checkpoint.load_part(folder, BEST, "agent")
            amounts = int(meta["steps"]), int(meta["updates"]), float(meta["seconds"])
            best = last if amounts[0] == training.steps else DueEvaluation(*amounts, agent, seeds)
        tests.pending += [last] if best in (None, last) else [last, best]
        tests.activity = "final test"
        results = dict(tests.play_remaining())
        if tests.pending:
            return False
        policies = {"last": (last, last_sha256), "best": (best, best_sha256)}
        final = {
            name: replace(results[test], checkpoint=name, sha256=sha256, seed=settings.final_seed)
            for name, (test, sha256) in policies.items()
            if test is not None
        }
        self._writer.write_final(final)
        self._tensorboard.add_final(final["last"])
        self.listener(RunFinalTested(self.folder.id, final))
        return True


def run_or_resume(
    folder: RunFolder, url: str | None, listener: Listener, stop: StopRequest, *, two_processes: bool
) -> RunSummary:
    """Execute the run of a folder, or resume it from its newest checkpoint. A finished run does not change.

    Arguments are those of `Run`.

    Raises:
        RunError: no checkpoint can be used, or a file that the spec names was changed.
        SpecError: its resolved spec is damaged, or of another version.
    """
    if folder.state().state == "finished":  # it may have been when the caller looked, before the lock was free
        return folder.summary()
    spec, seed = spec_from_dict(folder.spec()), folder.description()["seed"]
    check_files(spec, folder)
    begun = folder.events() or checkpoint.names(folder.checkpoints) or folder.state().steps  # any of these may be lost
    try:
        with stop.at_once():
            snapshot = newest_snapshot(folder) if begun else None
    except StopRequestedError:
        folder.set_state("stopped")
        return folder.summary()
    if snapshot is not None:
        folder.next_attempt()
    return Run(spec, seed, folder, url, listener, stop, snapshot, two_processes).execute()
