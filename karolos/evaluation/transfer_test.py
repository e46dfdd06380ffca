"""Tests a run's saved policy under changed settings: another robot, other physics, randomization."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from ..core import Failure
from ..core.signature import SAME_LAYOUTS, layout_differences
from ..environments.build import build_environment
from ..environments.robot_task import RobotTask
from ..errors import UsageError
from ..records import RunFolder, provenance, transfer_results
from ..records.results import TestCounts, TestResult
from ..records.run_records import timestamp
from ..records.transfer_results import TransferResult
from ..spec import Spec, spec_from_dict
from ..spec.merge import RANDOMIZATION
from ..training.assembly import located, make_orchestrator
from .policies import SavedAgent, load_agent, signature_of
from .testing import play_episodes, test_seeds

CHANGEABLE = ("robot", "task", "environment", "randomization", "orchestrator")
"""Keys of a spec that define the environment of a test. The other keys define the training."""


def transfer_test(
    folder: RunFolder,
    overrides: Sequence[str] = (),
    *,
    checkpoint: str = "best",
    episodes: int | None = None,
    seed: int | None = None,
    randomize: bool = False,
    on_failure: Callable[[Failure], object] = lambda _: None,
    on_round: Callable[[int], object] = lambda _: None,
) -> TransferResult:
    """Play test episodes of a run's policy under its spec with overrides, and write the result into the run's folder.

    The same policy's success on the same episodes under the unchanged spec stands beside it. It comes from the final
    test if that played these episodes; otherwise they are played, too.

    Args:
        folder: the run's.
        overrides: `path.to.key=value`, each below one of CHANGEABLE; also a parameter's value, e.g. task.gravity=-5.
        checkpoint: `best` or `last`.
        episodes: number of episodes; by default that of the final test, or of the run's tests without a final test.
        seed: root of the episodes' seeds; by default that of the final test, on whose episodes nothing was chosen.
        randomize: whether to draw the spec's `randomization` at each reset.
        on_failure: is called with each failure of an environment, whose episode is then played again.
        on_round: as for `play_episodes`; nothing is written if it raises an error.

    Raises:
        SpecError: an override is not valid.
        UsageError: an override is about training, observations, actions or goals have another layout than in training,
            or there is nothing to randomize.
        RunError: the checkpoint is missing or damaged.
        MachineError: the result cannot be written.
    """
    from ..agents.device import use_threads  # noqa: PLC0415  (imports torch)

    _check_keys(overrides)
    saved = load_agent(folder, checkpoint)
    spec = _spec_of_test(saved.spec, overrides, randomize=randomize)
    with located(spec):
        _check_layouts(spec, saved, overrides)
    seed = spec.testing.final_seed if seed is None else seed
    count = (spec.testing.final_count or spec.testing.episodes) if episodes is None else episodes
    use_threads(spec.training.threads or 1)  # as in training: sums in another order could change an episode

    def play(spec: Spec, *, drawing: bool) -> TestResult:
        with make_orchestrator(spec, randomize=drawing) as orchestrator:
            return play_episodes(
                orchestrator,
                saved.agent,
                test_seeds(seed, count),
                steps=saved.steps,
                seconds=saved.seconds,
                on_failure=on_failure,
                on_round=on_round,
            )

    started = time.perf_counter()
    result = play(spec, drawing=True)
    wall_seconds = time.perf_counter() - started
    own = result
    if overrides or randomize:
        own = _from_final_test(folder, saved, seed, count) or play(saved.spec, drawing=False)
    transfer = TransferResult(
        time=timestamp(),
        checkpoint=checkpoint,
        sha256=saved.sha256,
        overrides=tuple(overrides),
        randomized=randomize,
        seed=seed,
        wall_seconds=wall_seconds,
        result=result,
        own=TestCounts.of(own),
        versions=provenance.versions(),
    )
    transfer_results.add(folder, transfer)
    return transfer


def _from_final_test(folder: RunFolder, saved: SavedAgent, seed: int, count: int) -> TestResult | None:
    """The result of this policy on these episodes in the run's final test; None if it did not play them."""
    final = folder.final()
    if final is None or final.seed != seed:
        return None
    policies = {final.last_sha256: final.last, final.best_sha256: final.best}
    own = policies.get(saved.sha256)
    return own.first(count) if own is not None and own.episodes >= count else None


def _check_keys(overrides: Sequence[str]) -> None:
    """Raise a UsageError for an override outside CHANGEABLE."""
    for override in overrides:
        root = _key(override).partition(".")[0]
        if root not in CHANGEABLE:
            hint = f"a test can change {', '.join(CHANGEABLE)}"
            if root == "testing":
                hint = "use --episodes and --seed"
            raise UsageError(f"{override!r} is about training, not about the test", where="override", hint=hint)


def _spec_of_test(saved: Spec, overrides: Sequence[str], *, randomize: bool) -> Spec:
    """The spec of the test. Its `randomization` is what the test draws.

    An override of a parameter that is not a setting, e.g. task.gravity=-5, replaces its distribution. Without
    `randomize` these are the only distributions.
    """
    parameters = _parameters(saved, overrides)
    own = [f"{RANDOMIZATION}.{text.strip()}" if _key(text) in parameters else text for text in overrides]
    spec = spec_from_dict(saved.dump(), own)
    _check_randomization(spec, overrides, randomize=randomize)
    if randomize:
        return spec
    return spec.model_copy(update={RANDOMIZATION: {key: spec.randomization[key] for key in sorted(parameters)}})


def _parameters(saved: Spec, overrides: Sequence[str]) -> set[str]:
    """The keys of overrides that are parameters of the robot or task and not settings."""
    names = [text for text in overrides if _key(text).removesuffix(".name") in ("robot", "task")]
    spec = spec_from_dict(saved.dump(), names)
    parts = (("robot", spec.robot), ("task", spec.task))
    settings = {f"{key}.{name}" for key, part in parts if part for name in type(part.settings).model_fields}
    environment = build_environment(spec.recipe(randomize=False))
    declared = environment.declared if isinstance(environment, RobotTask) else {}
    environment.close()
    return {_key(text) for text in overrides} & set(declared) - settings


def _key(override: str) -> str:
    return override.partition("=")[0].strip()


def _check_randomization(spec: Spec, overrides: Sequence[str], *, randomize: bool) -> None:
    """Raise a UsageError if `randomize` has nothing to draw, or if `randomization` is given without it."""
    if randomize and not spec.randomization:
        raise UsageError(
            "there is nothing to randomize",
            where=RANDOMIZATION,
            hint="add a distribution: randomization.task.gravity='{name: normal, mean: -9.81, std: 0.5}'",
        )
    if not randomize and any(override.strip().startswith(RANDOMIZATION) for override in overrides):
        raise UsageError(
            "randomization is off in a test",
            where=RANDOMIZATION,
            hint="turn it on with --randomize, or give one parameter a value, e.g. task.gravity=-5",
        )


def _check_layouts(spec: Spec, saved: SavedAgent, overrides: Sequence[str]) -> None:
    differences = layout_differences(signature_of(spec, randomize=True), saved.signature)
    if differences:
        raise UsageError(
            "the policy was trained with other observations, actions or goals: " + "; ".join(differences),
            where=_changed(overrides),
            hint=SAME_LAYOUTS,
        )


def _changed(overrides: Sequence[str]) -> str:
    """The key of the first override that may have changed a layout."""
    keys = map(_key, overrides)
    return next((key for key in keys if key.partition(".")[0] in ("robot", "task", "environment")), "environment")
