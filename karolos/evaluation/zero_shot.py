"""Zero-shot tests: a run's saved policy under changed settings, e.g. on another robot or in other physics."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from ..environments.build import engine_of
from ..errors import RunError
from ..records import RunFolder, provenance
from ..records import checkpoint as checkpoints
from ..records.decode import from_json
from ..records.evaluation import Evaluation
from ..records.run_records import timestamp
from ..records.shipped import is_shipped, results_of
from ..specification import Spec
from ..system.files import read_object, write_json, writing
from ..training.assembly import make_orchestrator, use_threads
from .changed_spec import changed_spec, engine_note
from .policies import Learned, load_agent, playable
from .testing import play_episodes, test_seeds

REQUEST = "test.json"


@dataclass(frozen=True)
class ZeroShotTest:
    """A test that another process plays: the content of test.json in a folder of its own.

    The result goes into the folder of the policy's run, as with `karolos test`.
    """

    run: str
    """Folder of the policy's run."""
    checkpoint: str
    overrides: tuple[str, ...]
    """Changes to the run's spec."""
    episodes: int
    seed: int
    """Root of the episodes' seeds."""

    @classmethod
    def read(cls, folder: Path) -> ZeroShotTest | None:
        """The test of a folder; None if the folder holds no test. Raises RunError if it is damaged."""
        path = folder / REQUEST
        if not path.is_file():
            return None
        test = from_json(cls, read_object(path) or {})
        if test is None:
            raise RunError("test.json has no valid test", where=str(path), hint="remove the folder")
        return test

    def write(self, folder: Path) -> None:
        """Make the test's folder. Raises MachineError."""
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / REQUEST, asdict(self))

    def result(self) -> Evaluation | None:
        """The result in the run's folder; None if this policy has not played these episodes yet."""
        folder = RunFolder.open(self.run)
        sha256 = checkpoints.digest(folder.checkpoints, self.checkpoint, "agent")
        wanted = (sha256, self.overrides, False, self.seed, self.episodes)
        for done in folder.transfers().rows:
            if (done.sha256, done.overrides, done.randomized, done.seed, done.episodes) == wanted:
                return done
        return None

    def play(self, on_round: Callable[[int], object]) -> None:
        """Play it; nothing is written if `on_round` raises an error. Raises as `zero_shot_test`."""
        given = {name: value for name, value in vars(self).items() if name != "run"}
        zero_shot_test(RunFolder.open(self.run), **given, on_round=on_round)


def zero_shot_test(
    folder: RunFolder,
    overrides: Sequence[str] = (),
    *,
    checkpoint: str = "best",
    episodes: int | None = None,
    seed: int | None = None,
    randomize: bool = False,
    on_warning: Callable[[str], object] = lambda _: None,
    on_round: Callable[[int], object] = lambda _: None,
) -> Evaluation:
    """Play test episodes of a run's policy under its spec with overrides, and write the result into the run's folder.

    Nothing is written for a shipped run, see `keep`.

    The result also has the numbers of the same policy in the same episodes under the unchanged spec. They come from the
    final test if it played these episodes; otherwise they are played, too. If the run's engine is not installed,
    another one replaces it, and the result's overrides name it.

    Args:
        folder: the run's.
        overrides, randomize: as for `changed_spec`.
        checkpoint: `best` or `last`.
        episodes: by default those of the final test, or of the run's tests without a final test.
        seed: root of the episodes' seeds; by default that of the final test, whose episodes are held out.
        on_warning: is called with one line if the policy learned in another physics engine, and for each failure of an
            environment, whose episode is then played again.
        on_round: as for `play_episodes`; nothing is written if it raises an error.

    Raises as `changed_spec` and `load_agent`, and MachineError if the result cannot be written.
    """
    saved = load_agent(folder, checkpoint)
    here = playable(saved.spec)
    if here is not saved.spec and (engine := engine_of(here.environment)):
        overrides = tuple(dict.fromkeys((f"environment.engine={engine.name}", *overrides)))
    spec = changed_spec(saved.spec, overrides, trained=saved.signature, randomize=randomize)
    if note := engine_note(saved.spec, spec):
        on_warning(note)
    seed = spec.testing.final_seed if seed is None else seed
    count = spec.testing.held_out_count if episodes is None else episodes
    use_threads(spec)

    def play(spec: Spec, *, drawing: bool) -> Evaluation:
        with make_orchestrator(spec, randomize=drawing) as orchestrator:
            return play_episodes(
                orchestrator,
                saved.agent,
                test_seeds(seed, count),
                steps=saved.steps,
                seconds=saved.seconds,
                on_failure=lambda failure: on_warning(f"{failure.error}; its episodes are played again"),
                on_round=on_round,
            )

    started = time.perf_counter()
    result = play(spec, drawing=True)
    wall_seconds = time.perf_counter() - started
    own = result
    if overrides or randomize:
        own = final_of(folder, saved, seed, count) or play(here, drawing=False)
    test = replace(changed_test(saved, result, overrides, seed, wall_seconds, own), randomized=randomize)
    keep(folder, test)
    return test


def final_of(folder: RunFolder, saved: Learned, seed: int, count: int) -> Evaluation | None:
    """The first episodes of the final test of this policy, if it played them."""
    known = (one for one in folder.final().values() if (one.sha256, one.seed) == (saved.sha256, seed))
    final = next((one for one in known if one.episodes >= count), None)
    return final and Evaluation.joined([final], count)


def keep(folder: RunFolder, test: Evaluation, runs: Path | None = None) -> None:
    """Write a test under changed settings where `results_of` says; without `runs` not for a shipped run.

    Raises MachineError.
    """
    if runs is not None or not is_shipped(folder):
        kept = results_of(folder, runs or Path())
        with writing(kept.path):
            kept.path.mkdir(parents=True, exist_ok=True)
        kept.add_transfer(test)


def changed_test(
    saved: Learned, result: Evaluation, overrides: Sequence[str], seed: int, wall_seconds: float, own: Evaluation | None
) -> Evaluation:
    """The result of a test under changed settings, with the policy that played, the time and the software.

    `own` are the same episodes under the unchanged spec; None: they were not played.
    """
    return replace(
        result,
        overrides=tuple(overrides),
        seed=seed,
        wall_seconds=wall_seconds,
        own=own and own.counts,
        steps=saved.steps,
        seconds=saved.seconds,
        checkpoint=saved.checkpoint,
        sha256=saved.sha256,
        time=timestamp(),
        versions=provenance.versions(),
    )
