"""A run's saved policy under changed settings: another robot, other physics, randomization. Nothing is learned."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from ..core import Failure
from ..core.signature import SAME_LAYOUTS, layout_differences
from ..errors import UsageError
from ..records import RunFolder, provenance
from ..records import transfer_results as transfers
from ..records.run_records import timestamp
from ..records.transfer_results import TransferResult
from ..spec import Spec
from ..training.assembly import located, make_orchestrator
from .policies import SavedAgent, load_agent, signature_of
from .testing import play_episodes, test_seeds

CHANGEABLE = ("robot", "task", "environment", "randomization", "orchestrator")
"""Keys of a spec that say what a policy is tested in; the others say how it was trained."""


def transfer_test(
    folder: RunFolder,
    overrides: Sequence[str] = (),
    *,
    checkpoint: str = "best",
    episodes: int | None = None,
    seed: int | None = None,
    randomize: bool = False,
    on_failure: Callable[[Failure], object] | None = None,
) -> TransferResult:
    """Play test episodes of a run's policy under its spec with overrides, and keep the result in the run's folder.

    Args:
        folder: the run's.
        overrides: `path.to.key=value`, below one of CHANGEABLE.
        checkpoint: `best` or `last`.
        episodes: as many as in the run's own tests by default.
        seed: root of the episodes' seeds; that of the run's own tests by default, which makes the episodes the same.
        randomize: draw what the spec's `randomization` says at each reset; without it, nothing is drawn.
        on_failure: hears of environments that fail; their episodes are played again.

    Raises:
        SpecError: an override is not valid.
        UsageError: an override says how to train, observations, actions or goals are laid out in another way than
            where the agent was trained, or there is nothing to randomize.
        RunError: the run has no such checkpoint, or it is damaged.
        MachineError: the result cannot be written.
    """
    from ..agents.device import use_threads  # noqa: PLC0415  (imports torch)

    _check_keys(overrides)
    saved = load_agent(folder, checkpoint)
    spec = Spec.from_dict(saved.spec.dump(), overrides)
    _check_randomization(spec, overrides, randomize=randomize)
    with located(spec):
        _check_layouts(spec, saved, overrides, randomize=randomize)
    seed = spec.testing.seed if seed is None else seed
    count = spec.testing.episodes if episodes is None else episodes
    use_threads(spec.training.threads or 1)  # as in training: sums in another order could end an episode otherwise
    began = time.perf_counter()
    with make_orchestrator(spec, randomize=randomize) as orchestrator:
        result = play_episodes(
            orchestrator,
            saved.agent,
            test_seeds(seed, count),
            steps=saved.steps,
            seconds=saved.seconds,
            on_failure=on_failure,
        )
    transfer = TransferResult(
        time=timestamp(),
        checkpoint=checkpoint,
        sha256=saved.sha256,
        overrides=tuple(overrides),
        randomized=randomize,
        seed=seed,
        wall_seconds=time.perf_counter() - began,
        result=result,
        versions=provenance.versions(),
    )
    transfers.add(folder, transfer)
    return transfer


def _check_keys(overrides: Sequence[str]) -> None:
    """Raise a UsageError for the first override that would change more than what the policy is tested in."""
    for override in overrides:
        root = override.partition("=")[0].strip().partition(".")[0]
        if root not in CHANGEABLE:
            hint = f"a test can change {', '.join(CHANGEABLE)}"
            if root == "testing":
                hint = "give --episodes and --seed"
            raise UsageError(f"{override!r} says how to train, and the policy is trained", where="override", hint=hint)


def _check_randomization(spec: Spec, overrides: Sequence[str], *, randomize: bool) -> None:
    """Raise a UsageError where nothing is there to draw, or would not be drawn."""
    if randomize and not spec.randomization:
        raise UsageError(
            "there is nothing to randomize",
            where="randomization",
            hint="say what: randomization.task.gravity='{name: normal, mean: -9.81, std: 0.5}'",
        )
    if not randomize and any(override.strip().startswith("randomization") for override in overrides):
        raise UsageError("randomization is off in a test", where="randomization", hint="turn it on with --randomize")


def _check_layouts(spec: Spec, saved: SavedAgent, overrides: Sequence[str], *, randomize: bool) -> None:
    told = layout_differences(signature_of(spec, randomize=randomize), saved.signature)
    if told:
        raise UsageError(
            "the policy sees and does other things than this environment has: " + "; ".join(told),
            where=_changed(overrides),
            hint=SAME_LAYOUTS,
        )


def _changed(overrides: Sequence[str]) -> str:
    """The key of the first override that may have changed a layout."""
    roots = [override.partition("=")[0].strip() for override in overrides]
    return next((key for key in roots if key.partition(".")[0] in ("robot", "task", "environment")), "environment")
