"""A matrix of transfers: trains every source, tests its policies on every target, and fine-tunes them there.

The run of a variant has two roles: it is a source of policies, and the training from scratch on that target. The task
may refuse a target without runs, for example an arm with too small a workspace: the report names it with the reason.
runs/transfers/<name>/ holds only what the runs do not hold:
    baselines.jsonl    success of random actions and of the scripted expert on each variant
    tests/             folders of zero-shot tests while a launcher's processes play them
    lock               held by the process of the matrix
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path

from typing_extensions import override

from .. import system
from ..core.signature import SAME_LAYOUTS, layout_differences
from ..errors import PluginError, RunError, UsageError
from ..evaluation.playing import evaluate_alone
from ..evaluation.policies import expert_policy, random_policy, signature_of
from ..evaluation.zero_shot import ZeroShotTest
from ..experiment.check import check_parts
from ..experiment.events import RunEvent
from ..experiment.resume import find_run
from ..experiment.start_from import check_agents, pinned
from ..launchers.driver import FolderTask, Job
from ..launchers.runs import RunJob
from ..records import RunFolder, checkpoint, scan
from ..records.decode import from_json
from ..records.evaluation import Evaluation
from ..specification import Spec, spec_from_dict, spec_of_variant
from ..system.files import append_lines, read_lines
from .plan import Plan

CHECKPOINT = "best"
"""The policy of a source that is tested and fine-tuned."""
LONGEST_NAME = 64
BASELINE_EPISODES = 200
"""Largest number of episodes of the random policy and of the expert: the first ones of the final test."""

Pair = tuple[str, str]
"""Source and target."""


@dataclass(frozen=True)
class Baselines:
    """Success on a variant without learning."""

    floor: Evaluation
    """Success of uniformly random actions."""
    ceiling: Evaluation | None
    """Success of the task's scripted expert; None without one."""


class Matrix(Plan):
    """The matrix that a spec's `transfer` describes.

    Raises:
        SpecError: the settings of a variant or of fine-tuning are invalid.
        UsageError: the spec has no transfer, or its name is too long.
    """

    what, place = "matrix", "transfers"

    def __init__(self, spec: Spec) -> None:
        if spec.transfer is None:
            raise UsageError(
                f"the spec {spec.name!r} has no transfer", hint="add e.g. transfer: {robots: [panda, ur5]}"
            )
        self.spec, self.transfer = spec, spec.transfer
        self.name = self.folder_name = spec.name
        labels = list(self.transfer.settings)
        self.pairs = [pair for pair in permutations(labels, 2) if pair[0] in self.transfer.source_names]
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
        self.sources: dict[str, dict[int, RunFolder]] = {}
        """Variant -> seed -> its finished run."""
        self.zero_shot: dict[Pair, dict[int, Evaluation]] = {}
        """Pair -> seed -> test of the source's policy on the target."""
        self.fine_tuned: dict[Pair, dict[int, RunFolder]] = {}
        """Pair -> seed -> its finished run."""
        self.baselines: dict[str, Baselines] = {}
        """Variant -> success without learning."""
        self.refused: dict[str, str] = {}
        """Target without runs of its own -> why the robot and the task do not go together."""
        self.problems: list[str] = []
        """Missing runs and tests, with the reasons."""

    def __str__(self) -> str:
        """The content of the matrix, in one line."""
        count, steps = len(self.spec.seeds), self.spec.training.steps
        sources, trained = len(self.transfer.source_names), len(self.transfer.trained)
        parts = [f"{sources * count} sources of {steps:,} steps"]
        if trained > sources:
            parts.append(f"{(trained - sources) * count} references")
        if "zero_shot" in self.transfer.modes:
            parts.append(f"{len(self.pairs) * count} tests of {self.spec.testing.held_out_count:,} episodes")
        if self._tuned:
            tuned = next(iter(self._tuned.values()))
            parts.append(f"{len(self.pairs) * count} fine-tuned runs of {tuned.training.steps:,} steps")
        return ", ".join(parts)

    @override
    def check(self) -> None:
        jobs = self.jobs or 1
        with self.spec.located():
            signatures = {}
            for label, variant in self.variants.items():
                try:
                    if label in self.transfer.trained:
                        check_parts(variant, jobs)
                    signatures[label] = signature_of(variant)
                except (PluginError, UsageError) as error:
                    if label in self.transfer.trained and error.setting in self.transfer.settings[label]:
                        place = self.transfer.place(label)
                        raise UsageError(f"{error.setting}: {error.what}", setting=place, hint=error.hint) from error
                    if label in self.transfer.trained:
                        raise
                    self.refused[label] = "; ".join(filter(None, (error.what, error.hint)))
                    continue
                if not signatures[label].has_success:
                    raise UsageError(
                        "its environment does not define success, which measures transfer",
                        setting=self.transfer.place(label),
                        hint="give environment.success_return, or another environment",
                    )
            self.pairs = [pair for pair in self.pairs if pair[1] not in self.refused]
            if not self.pairs:
                what = f"no target can be used: {next(iter(self.refused.values()))}"
                raise UsageError(what, setting=self.transfer.place(next(iter(self.refused))))
            robots = [one.robot for one in self.variants.values() if one.robot is not None]
            by_joints = any(getattr(one.settings, "control", None) == "joint" for one in robots)
            for source, target in self.pairs:
                if differences := layout_differences(signatures[target], signatures[source]):
                    raise UsageError(
                        f"a policy of {source} cannot act on {target}: {'; '.join(differences)}",
                        setting=self.transfer.place(target),
                        hint=f"{'set robot.control=cartesian: ' if by_joints else ''}{SAME_LAYOUTS}",
                    )
                changed = spec_from_dict(self.variants[source].dump(), self.overrides[target])
                if changed.recipe(randomize=False) != self.variants[target].recipe(randomize=False):
                    raise UsageError(
                        f"the settings of {target} do not turn {source} into {target}",
                        setting=self.transfer.place(target),
                        hint="give every variant the same settings, with the values that it has",
                    )
            for label in dict.fromkeys(target for _, target in self.pairs if self._tuned):
                tuned = self._tuned[label]
                check_parts(tuned, jobs)
                if "start_from" not in type(tuned.agent.settings).model_fields:
                    raise UsageError(
                        f"{tuned.agent.name} cannot start from another run",
                        setting="transfer.modes",
                        hint="leave out fine_tune",
                    )
                _check_tuned(tuned, self.variants[label])

    @override
    def execute(self) -> bool:
        variants = {label: pinned(self.variants[label], self.home.runs) for label in self.transfer.trained}
        self._check_begun(variants.values())
        self.say(f"{self.name}: {self}")
        home = replace(self.home, existing="resume")
        sources = {label: RunJob(spec, home, known=self._trained(spec)) for label, spec in variants.items()}
        self.driver.run(sources.values())
        self.sources = {label: self._finished(job) for label, job in sources.items()}
        self.driver.stop.check()
        if "zero_shot" in self.transfer.modes:
            self._test()
            self.driver.stop.check()
        for label, spec in self.variants.items():
            if label in self.refused:
                continue
            with self.driver.stop.at_once():
                self.baselines[label] = measure_baselines(spec, self.folder / "baselines.jsonl")
        tuned = [(pair, RunJob(spec, home)) for pair, spec in self._fine_tuning()]
        self.driver.run(job for _, job in tuned)
        for pair, job in tuned:
            self.fine_tuned.setdefault(pair, {}).update(self._finished(job))
        return not self.problems and all(job.finished for job in (*sources.values(), *(job for _, job in tuned)))

    def _check_begun(self, variants: Iterable[Spec]) -> None:
        """Raise an error if the matrix has begun and is not to be resumed, or if it cannot be resumed."""
        begun = [
            folder
            for spec in variants
            for seed in spec.seeds
            if (folder := find_run(self.home.runs, spec.name, spec.hash(), seed)) is not None
        ]
        finished = [folder for folder in begun if folder.state().state == "finished"]
        if begun and self.home.existing == "ignore":
            count = len(self.transfer.trained) * len(self.spec.seeds)
            raise UsageError(
                f"the matrix {self.name} exists: {len(finished)} of {count} sources are finished",
                where=str(self.home.runs),
                hint="--resume continues it without repeating runs; name=... begins another one",
            )
        for folder in finished:
            _require_checkpoint(folder)

    def _trained(self, spec: Spec) -> dict[int, RunFolder]:
        """Seed -> finished run of this experiment under another name, if the variant's name has none for the seed."""
        found: dict[int, RunFolder] = {}
        experiment = spec.hash()
        for folder in scan(self.home.runs):
            if isinstance(folder, RunError) or folder.description()["experiment"] != experiment:
                continue
            seed, is_finished = folder.description()["seed"], folder.state().state == "finished"
            if seed not in spec.seeds or not is_finished or CHECKPOINT not in checkpoint.names(folder.checkpoints):
                continue
            if seed not in found and find_run(self.home.runs, spec.name, experiment, seed) is None:
                found[seed] = folder
                self.say(f"{folder.id} has the settings of {spec.name}: it is not trained again")
        return found

    def _finished(self, job: RunJob) -> dict[int, RunFolder]:
        """Seed -> finished run of a job. Notes the others."""
        self.problems += job.problems()
        finished = {seed for seed, summary in job.summaries.items() if summary.state == "finished"}
        return {seed: job.folders[seed] for seed in job.spec.seeds if seed in finished}

    def _test(self) -> None:
        """Play the zero-shot tests of every pair and seed that are not played yet."""
        job = Job()
        job.listed = tests = [
            ZeroShotTask(job, self, pair, seed) for pair in self.pairs for seed in self.sources[pair[0]]
        ]
        self.driver.run([job])
        for task in tests:
            if task.result is not None:
                self.zero_shot.setdefault(task.pair, {})[task.seed] = task.result

    def _fine_tuning(self) -> Iterator[tuple[Pair, Spec]]:
        """The fine-tuning of each pair and seed with a finished source."""
        for source, target in self.pairs if self._tuned else ():
            for seed, folder in self.sources[source].items():
                name = _name(self.spec, source, target)
                spec = self._tuned[target].model_copy(update={"name": name, "seeds": (seed,)})
                spec = spec.having("agent", start_from=folder.id, start_checkpoint=CHECKPOINT)
                yield (source, target), pinned(spec, self.home.runs)


@dataclass(eq=False)
class ZeroShotTask(FolderTask):
    """The test of a source's policy on a target. Its folder exists only while a process plays it."""

    job: Job
    matrix: Matrix
    pair: Pair
    seed: int
    result: Evaluation | None = None

    def __post_init__(self) -> None:
        (source, target), testing = self.pair, self.matrix.spec.testing
        run = self.matrix.sources[source][self.seed]
        _require_checkpoint(run)
        self.test = ZeroShotTest(
            run=str(run.path.resolve()),
            checkpoint=CHECKPOINT,
            overrides=self.matrix.overrides[target],
            episodes=testing.held_out_count,
            seed=testing.final_seed,
        )
        self.folder = self.matrix.folder / "tests" / f"{_name(self.matrix.spec, source, target)}-s{self.seed}"
        if self._has_result():
            self.state = "over"

    def __str__(self) -> str:
        return f"{self.pair[0]} to {self.pair[1]}, seed {self.seed}"

    def _has_result(self) -> bool:
        self.result = self.test.result()
        if self.result is None:
            return False
        self.matrix.say(f"{self}: success end {self.result.success_end or 0:.3f} of {self.result.episodes:,}")
        return True

    @override
    def begin(self) -> Path:
        self.test.write(self.folder)
        return self.folder

    @override
    def is_over(self) -> bool:
        return self.test.result() is not None

    @override
    def end(self, problem: str | None) -> Iterator[RunEvent]:
        system.remove_tree(self.folder)
        with suppress(OSError):
            self.folder.parent.rmdir()  # of the last one
        if not self._has_result() and not self.job.halted:
            self.matrix.problems.append(f"the test of {self}: {problem or 'it has no result'}")
        yield from ()


def _name(spec: Spec, source: str, target: str | None = None) -> str:
    """The name of the runs of a source, or of its fine-tuning on a target."""
    return f"{spec.name}-{source}" + (f"-to-{target}" if target is not None else "")


def _require_checkpoint(folder: RunFolder) -> None:
    if CHECKPOINT not in checkpoint.names(folder.checkpoints):
        raise RunError(
            f"the source has no checkpoint {CHECKPOINT!r}",
            where=folder.id,
            hint=f"restore it, or remove the run (`karolos runs rm {folder.id}`) to train it again with --resume",
        )


def measure_baselines(spec: Spec, path: Path) -> Baselines:
    """Success of random actions and of the expert, read from the file if it was measured before."""
    episodes = min(spec.testing.held_out_count, BASELINE_EPISODES)
    key = {"experiment": spec.hash(), "episodes": episodes}
    for row in read_lines(path).rows:
        if key.items() <= row.items() and (known := from_json(Baselines, row)) is not None:
            return known
    seed = spec.testing.final_seed
    floor = evaluate_alone(spec, lambda one: random_policy(one, seed), episodes=episodes, seed=seed).counts
    try:
        ceiling = evaluate_alone(spec, expert_policy, episodes=episodes, seed=seed).counts
    except UsageError:  # there is no expert
        ceiling = None
    append_lines(path, [key | {"floor": floor.encode(), "ceiling": ceiling and ceiling.encode()}])
    return Baselines(floor, ceiling)


def _check_tuned(tuned: Spec, source: Spec) -> None:
    """As `check_agents`, told at the matrix's own setting: its user names no run."""
    try:
        check_agents(tuned, source)
    except UsageError as error:
        hint = "networks are those of the source: leave these settings out of fine_tune"
        raise UsageError(error.what, setting="transfer.fine_tune", hint=hint) from None
