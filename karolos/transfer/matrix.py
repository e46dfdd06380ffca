"""A matrix of transfers: trains every source, tests its policies on every target, and fine-tunes them there.

The runs are ordinary runs. The run of a variant is a source of policies, and what training from scratch achieves on
that variant as a target. runs/transfers/<name>/ holds what no run holds:
    baselines.jsonl    success of random actions and of the scripted expert on each variant
    tests/             what the processes of a launcher need for tests, while they are played
    lock               held by the process of the matrix
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import permutations
from pathlib import Path

from ..core.signature import SAME_LAYOUTS, layout_differences
from ..errors import RunError, UsageError
from ..evaluation.policies import signature_of
from ..evaluation.zero_shot import ZeroShotTest
from ..experiment.events import Listener
from ..experiment.resume import find_run
from ..experiment.signals import StopRequestedError
from ..experiment.start_from import check_agents, pinned
from ..files import locked
from ..launchers.driver import Driver, Feed, driving
from ..launchers.runs import Home, RunJob
from ..records import RunFolder, checkpoint, scan
from ..records.evaluation import Evaluation
from ..specification import Spec, spec_from_dict, spec_of_variant
from ..training.assembly import check_parts, located
from .baselines import Baselines, measure_baselines
from .zero_shot import ZeroShotJob

FOLDER = "transfers"
CHECKPOINT = "best"
"""The policy of a source that is tested and fine-tuned."""
LONGEST_NAME = 64

Pair = tuple[str, str]
"""Source and target."""


@dataclass
class MatrixRuns:
    """The finished runs and tests of a matrix. After a stop or a failure some are missing."""

    spec: Spec
    folder: Path
    """Of the matrix."""
    sources: dict[str, dict[int, RunFolder]] = field(default_factory=dict)
    """Variant -> seed -> its run."""
    zero_shot: dict[Pair, dict[int, Evaluation]] = field(default_factory=dict)
    """Pair -> seed -> test of the source's policy on the target."""
    fine_tuned: dict[Pair, dict[int, RunFolder]] = field(default_factory=dict)
    """Pair -> seed -> its run."""
    baselines: dict[str, Baselines] = field(default_factory=dict)
    """Variant -> success without learning."""
    problems: list[str] = field(default_factory=list)
    """Which runs are missing, and why."""
    stop_code: int = 0

    @property
    def exit_code(self) -> int:
        """0 if nothing is missing, else 1; after a stop 128 + signal, or 124 for the time limit."""
        return self.stop_code or int(bool(self.problems))


class Matrix:
    """The matrix that a spec's `transfer` describes.

    Args:
        spec: with a transfer.

    Raises:
        SpecError: the settings of a variant or of fine-tuning are invalid.
        UsageError: the spec has no transfer, or its name is too long.
    """

    def __init__(self, spec: Spec) -> None:
        if spec.transfer is None:
            raise UsageError(
                f"the spec {spec.name!r} has no transfer", hint="add e.g. transfer: {robots: [panda, ur5]}"
            )
        self.spec, self.transfer = spec, spec.transfer
        labels = list(self.transfer.settings)
        self.pairs = list(permutations(labels, 2))
        longest = max((_name(spec, *pair) for pair in self.pairs), key=len)
        if len(longest) > LONGEST_NAME:
            raise UsageError(
                f"runs would be called {longest}, which is longer than {LONGEST_NAME} characters",
                setting="name",
                hint="give a shorter one (name=...)",
            )
        self.variants = {label: spec_of_variant(spec, label, _name(spec, label), spec.seeds) for label in labels}
        self._tuned = {
            label: spec_of_variant(spec, label, _name(spec, label), spec.seeds, fine_tune=True)
            for label in labels
            if "fine_tune" in self.transfer.modes
        }
        self.overrides = {
            label: tuple(f"{key}={json.dumps(value)}" for key, value in settings.items())
            for label, settings in self.transfer.settings.items()
        }

    def __str__(self) -> str:
        """What the matrix consists of, in one line."""
        count, steps = len(self.spec.seeds), self.spec.training.steps
        parts = [f"{len(self.variants) * count} sources of {steps:,} steps"]
        if "zero_shot" in self.transfer.modes:
            testing = self.spec.testing
            parts.append(f"{len(self.pairs) * count} tests of {testing.final_count or testing.episodes:,} episodes")
        if self._tuned:
            tuned = next(iter(self._tuned.values()))
            parts.append(f"{len(self.pairs) * count} fine-tuned runs of {tuned.training.steps:,} steps")
        return ", ".join(parts)

    def check(self, jobs: int = 1) -> None:
        """Raise an error for what cannot work, before anything runs. `jobs`: runs at the same time."""
        with located(self.spec):
            signatures = {}
            for label, variant in self.variants.items():
                check_parts(variant, jobs)
                signatures[label] = signature_of(variant)
                if not signatures[label].has_success:
                    raise UsageError(
                        "its environment does not define success, by which transfer is measured",
                        setting=self.transfer.place(label),
                        hint="give environment.success_return, or another environment",
                    )
            for source, target in self.pairs:
                if differences := layout_differences(signatures[target], signatures[source]):
                    raise UsageError(
                        f"a policy of {source} cannot act on {target}: {'; '.join(differences)}",
                        setting=self.transfer.place(target),
                        hint=_layout_hint(self.variants.values()),
                    )
                self._check_overrides(source, target)
            for label, tuned in self._tuned.items():
                check_parts(tuned, jobs)
                if "start_from" not in type(tuned.agent.settings).model_fields:
                    raise UsageError(
                        f"{tuned.agent.name} cannot start from another run",
                        setting="transfer.modes",
                        hint="leave out fine_tune",
                    )
                check_agents(tuned, self.variants[label])

    def _check_overrides(self, source: str, target: str) -> None:
        """Raise a UsageError unless the target's settings turn the source's environment into the target's."""
        changed = spec_from_dict(self.variants[source].dump(), self.overrides[target])
        if changed.recipe(randomize=False) != self.variants[target].recipe(randomize=False):
            raise UsageError(
                f"the settings of {target} do not turn {source} into {target}",
                setting=self.transfer.place(target),
                hint="give every variant the same settings, with the values that it has",
            )

    def run(
        self,
        runs: str | Path = "runs",
        *,
        database: str | None = None,
        jobs: int | None = None,
        resume: bool = False,
        time_limit: float | None = None,
        listener: Listener = lambda _: None,
        say: Callable[[str], None] = lambda _: None,
    ) -> MatrixRuns:
        """Run what is missing of the matrix, and nothing twice.

        Args:
            runs: folder of the run folders; the matrix's own is `transfers/<name>` in it.
            database: SQLAlchemy URL of the results database.
            jobs: runs at the same time, each in its own process; None: one, or with another launcher than `local` as
                many as it has room for.
            resume: whether to continue a matrix that has begun.
            time_limit: seconds after which to stop.
            listener: is called with every RunEvent.
            say: is called with a line for each test and phase.

        Raises:
            SpecError, UsageError: the matrix cannot work, or has begun and is not to be resumed.
            RunError: a source has no checkpoint, or another process runs this matrix.
            MachineError: the runs folder cannot be written, or processes cannot be started.
            StoreError: the database cannot be used.
        """
        self.check(jobs or 1)
        home = Home.prepared(self.spec, runs, database, "resume")
        root = home.runs
        found = MatrixRuns(self.spec, root / FOLDER / self.spec.name)
        refusal = RunError("another process runs this matrix", where=str(found.folder), hint="wait for it")
        variants = {label: pinned(spec, root) for label, spec in self.variants.items()}
        with (
            locked(found.folder / "lock", refusal, seconds=0),
            driving(self.spec, jobs, listener, time_limit) as driver,
        ):
            self._check_begun(variants, root, resume=resume)
            say(f"{self.spec.name}: {self}")
            sources = {label: RunJob(spec, home, known=_trained(spec, root, say)) for label, spec in variants.items()}
            driver.run(Feed(*sources.values()))
            for label, job in sources.items():
                found.sources[label] = _finished(job, found)
            with suppress(StopRequestedError):
                self._measure(found, driver, say)
                tuned = list(self._fine_tuning(found, home))
                driver.run(Feed(*(job for _, job in tuned)))
                for pair, job in tuned:
                    found.fine_tuned.setdefault(pair, {}).update(_finished(job, found))
                if all(job.finished for job in (*sources.values(), *(job for _, job in tuned))):
                    return found
            found.stop_code = driver.stop.exit_code
        return found

    def _check_begun(self, variants: Mapping[str, Spec], runs: Path, *, resume: bool) -> None:
        """Raise an error if the matrix has begun and is not to be resumed, or if it cannot be resumed."""
        begun = [
            folder
            for spec in variants.values()
            for seed in spec.seeds
            if (folder := find_run(runs, spec.name, spec.hash(), seed)) is not None
        ]
        finished = [folder for folder in begun if folder.state().state == "finished"]
        if begun and not resume:
            count = len(variants) * len(self.spec.seeds)
            raise UsageError(
                f"the matrix {self.spec.name} has begun: {len(finished)} of {count} sources are finished",
                where=str(runs),
                hint="--resume continues it and runs nothing twice; name=... begins another one",
            )
        for folder in finished:
            _require_checkpoint(folder)

    def _measure(self, found: MatrixRuns, driver: Driver, say: Callable[[str], None]) -> None:
        """Test the sources on the targets, and measure the baselines. Raises StopRequestedError."""
        driver.stop.check()
        if "zero_shot" in self.transfer.modes:
            self._test(found, driver, say)
            driver.stop.check()
        for label, spec in self.variants.items():
            with driver.stop.at_once():
                found.baselines[label] = measure_baselines(spec, found.folder / "baselines.jsonl", driver.stop)

    def _test(self, found: MatrixRuns, driver: Driver, say: Callable[[str], None]) -> None:
        """Play the zero-shot tests of every pair and seed."""
        testing, tests, cells = self.spec.testing, dict[Path, ZeroShotTest](), dict[Path, tuple[Pair, int]]()
        episodes = testing.final_count or testing.episodes
        for pair in self.pairs:
            for seed, run in found.sources[pair[0]].items():
                _require_checkpoint(run)
                folder = (found.folder / "tests" / f"{_name(self.spec, *pair)}-s{seed}").resolve()
                cells[folder] = pair, seed
                tests[folder] = ZeroShotTest(
                    str(run.path.resolve()), CHECKPOINT, self.overrides[pair[1]], episodes, testing.final_seed
                )
        played: dict[Path, Evaluation] = {}

        def heard(folder: Path, test: Evaluation | None, problem: str | None) -> None:
            (source, target), seed = cells[folder]
            cell = f"{source} to {target}, seed {seed}"
            if test is None:
                found.problems.append(f"the test of {cell}: {problem}")
                return
            played[folder] = test
            say(f"{cell}: success end {test.success_end or 0:.3f} of {test.episodes:,}")

        driver.run(Feed(ZeroShotJob(tests, heard)))
        for folder, (pair, seed) in cells.items():  # in this order, whichever ended first
            if folder in played:
                found.zero_shot.setdefault(pair, {})[seed] = played[folder]

    def _fine_tuning(self, found: MatrixRuns, home: Home) -> Iterator[tuple[Pair, RunJob]]:
        """A job for each pair and seed with a finished source."""
        for source, target in self.pairs if self._tuned else ():
            for seed, folder in found.sources[source].items():
                name = _name(self.spec, source, target)
                spec = self._tuned[target].model_copy(update={"name": name, "seeds": (seed,)})
                start = {"start_from": folder.id, "start_checkpoint": CHECKPOINT}
                agent = replace(spec.agent, settings=spec.agent.settings.model_copy(update=start))
                spec = pinned(spec.model_copy(update={"agent": agent}), home.runs)
                yield (source, target), RunJob(spec, home)


def _name(spec: Spec, source: str, target: str | None = None) -> str:
    """The name of the runs of a source, or of its fine-tuning on a target."""
    return f"{spec.name}-{source}" + (f"-to-{target}" if target is not None else "")


def _layout_hint(variants: Iterable[Spec]) -> str:
    """What to do about layouts that differ."""
    joint = any(getattr(one.robot.settings, "control", None) == "joint" for one in variants if one.robot is not None)
    return f"{'set robot.control=cartesian: ' if joint else ''}{SAME_LAYOUTS}"


def _finished(job: RunJob, found: MatrixRuns) -> dict[int, RunFolder]:
    """Seed -> finished run of a job. Notes the others."""
    for summary in job.summaries.values():
        if summary.state != "finished":
            found.problems.append(": ".join(filter(None, (f"{summary.run} is {summary.state}", summary.error))))
    return {
        seed: RunFolder.open(job.summaries[seed].folder)
        for seed in job.spec.seeds
        if seed in job.summaries and job.summaries[seed].state == "finished"
    }


def _trained(spec: Spec, runs: Path, say: Callable[[str], None]) -> dict[int, RunFolder]:
    """Seed -> finished run of this experiment under another name, for seeds that have none under the variant's."""
    found: dict[int, RunFolder] = {}
    experiment = spec.hash()
    for folder in scan(runs):
        if isinstance(folder, RunError) or folder.description()["experiment"] != experiment:
            continue
        seed, is_finished = folder.description()["seed"], folder.state().state == "finished"
        if seed not in spec.seeds or not is_finished or CHECKPOINT not in checkpoint.names(folder.checkpoints):
            continue
        if seed not in found and find_run(runs, spec.name, experiment, seed) is None:
            found[seed] = folder
            say(f"{folder.id} has the settings of {spec.name}: it is not trained again")
    return found


def _require_checkpoint(folder: RunFolder) -> None:
    if CHECKPOINT not in checkpoint.names(folder.checkpoints):
        raise RunError(
            f"the source has no checkpoint {CHECKPOINT!r}",
            where=folder.id,
            hint=f"restore it, or remove the run (`karolos runs rm {folder.id}`) to train it again with --resume",
        )
