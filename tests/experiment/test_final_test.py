"""The final test of a run: its episodes, its policies, where it is stored, and what a kill leaves of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support import toy_runs

from karolos import checkpoint
from karolos.errors import MachineError
from karolos.evaluation import due_tests
from karolos.evaluation.policies import load_agent
from karolos.evaluation.testing import play_episodes, test_seeds
from karolos.experiment.events import RunFinalTested
from karolos.launchers.experiment import Experiment, Outcome, resume_run
from karolos.records import RunFolder
from karolos.records.run_folder import FINAL as FILE
from karolos.specification import spec_from_dict
from karolos.store import Store, reindex
from karolos.training.assembly import make_orchestrator

pytestmark = pytest.mark.xdist_group(__name__)

TOY = toy_runs.toy(training={"steps": 120}, testing={"interval": 20, "episodes": 4, "final_episodes": 9, "seed": 3})


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    return Experiment(TOY | {"seeds": [0, 1]}).run(tmp_path_factory.mktemp("runs"))


def folder_of(outcome: Outcome, place: int = 0) -> RunFolder:
    return RunFolder.open(outcome.runs[place].folder)


def test_a_run_ends_with_a_test_of_last_and_best_on_episodes_that_no_other_test_played(outcome: Outcome) -> None:
    folder = folder_of(outcome)
    final = folder.final()
    assert final is not None
    assert final.seed == 3 + 1_000_000
    assert not set(test_seeds(final.seed, 9)) & set(test_seeds(3, 4))
    for name, result in (("last", final.last), ("best", final.best)):
        saved = load_agent(folder, name)
        with make_orchestrator(saved.spec, randomize=False) as environments:
            again = play_episodes(environments, saved.agent, test_seeds(final.seed, 9), steps=saved.steps)
        assert result is not None
        assert replace(result, seconds=0.0) == again
        assert result.episodes == 9
    assert (final.last_sha256, final.best_sha256) == (
        load_agent(folder, "last").sha256,
        load_agent(folder, "best").sha256,
    )


def test_the_reported_success_is_that_of_the_final_test_in_the_folder_and_the_index(outcome: Outcome) -> None:
    for summary in outcome.runs:
        final = RunFolder.open(summary.folder).final()
        assert final is not None
        assert final.best is not None
        assert (summary.success_any, summary.success_end) == (final.last.success_any, final.last.success_end)
        assert (summary.episodes, summary.final) == (9, True)
        assert (summary.best_steps, summary.best_end) == (final.best.steps, final.best.success_end)
        with Store(Store.default_url(Path(summary.folder).parent)) as store:
            assert store.find(summary.run) == summary
            reindex(store, Path(summary.folder).parent)
            assert store.find(summary.run) == summary


def test_its_event_comes_once_it_is_written(tmp_path: Path) -> None:
    seen = []

    def listen(event: object) -> None:
        if isinstance(event, RunFinalTested):
            [path] = tmp_path.glob(f"*/{FILE}")
            seen.append((event.final, RunFolder.open(path.parent).final()))

    Experiment(TOY).run(tmp_path, listener=listen)
    [(told, written)] = seen
    assert told == written


def test_the_best_policy_is_tested_where_the_last_could_not_be_saved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save = checkpoint.save

    def full(folder: Path, name: str, *content: Any) -> Path:
        if name == "last":
            raise MachineError("no space left on the disk")
        return save(folder, name, *content)

    monkeypatch.setattr("karolos.checkpoint.save", full)
    [summary] = Experiment(TOY).run(tmp_path, check=False).runs
    assert summary.state == "failed"
    final = RunFolder.open(summary.folder).final()
    assert final is not None
    assert final.best is not None
    assert (final.last_sha256, bool(final.best_sha256)) == ("", True)
    assert summary.best_steps == final.best.steps


def test_no_final_test_without_final_episodes(tmp_path: Path) -> None:
    spec = TOY | {"testing": TOY["testing"] | {"final_episodes": 0}}
    [summary] = Experiment(spec).run(tmp_path).runs
    folder = RunFolder.open(summary.folder)
    assert folder.final() is None
    assert not (folder.path / FILE).exists()
    assert (summary.final, summary.best_end) == (False, None)
    assert summary.success_end == folder.tests()[-1].success_end


def test_null_plays_as_many_episodes_as_a_test_and_is_the_same_experiment() -> None:
    testing = {"interval": 20, "episodes": 4}
    absent = spec_from_dict(TOY | {"testing": testing})
    assert absent.testing.final_count == 4
    assert absent.hash() == spec_from_dict(TOY | {"testing": testing | {"final_episodes": 4}}).hash()
    assert absent.hash() != spec_from_dict(TOY | {"testing": testing | {"final_episodes": 5}}).hash()


def test_a_run_killed_in_its_final_test_plays_it_on_resume(
    tmp_path: Path, outcome: Outcome, monkeypatch: pytest.MonkeyPatch
) -> None:
    played = due_tests.play_episodes

    def killed(environments: Any, agent: Any, seeds: Any, **options: Any) -> Any:
        if len(seeds) == 9:
            raise KeyboardInterrupt
        return played(environments, agent, seeds, **options)

    with monkeypatch.context() as patch:
        patch.setattr(due_tests, "play_episodes", killed)
        with pytest.raises(KeyboardInterrupt):
            Experiment(TOY).run(tmp_path)
    [path] = tmp_path.glob("toy-s0-*")
    folder = RunFolder.open(path)
    assert folder.final() is None
    assert folder.state().state == "stopped"
    [summary] = resume_run(folder, Store.default_url(tmp_path)).runs
    assert summary.state == "finished"
    ours, theirs = folder.final(), folder_of(outcome).final()
    assert ours is not None
    assert theirs is not None
    assert replace(ours.last, seconds=0.0) == replace(theirs.last, seconds=0.0)
    assert ours.best is not None
    assert theirs.best is not None
    assert replace(ours.best, seconds=0.0) == replace(theirs.best, seconds=0.0)


@pytest.mark.parametrize("damage", [lambda text: text[:-40], lambda text: "{}\n", lambda text: text.splitlines()[0]])
def test_a_damaged_file_is_named_and_the_last_test_counts_instead(outcome: Outcome, damage: Any) -> None:
    folder = folder_of(outcome, 1)
    path = folder.path / FILE
    whole = path.read_text()
    try:
        path.write_text(damage(whole))
        record = folder.record()
        assert f"{FILE}: damaged; left out" in record.problems
        assert record.summary.final is False
        assert record.summary.success_end == folder.tests()[-1].success_end
    finally:
        path.write_text(whole)
    assert folder.record().problems == ()


def test_the_file_has_one_line_for_the_test_and_one_per_policy(outcome: Outcome) -> None:
    lines = (folder_of(outcome).path / FILE).read_text().splitlines()
    description, *played = map(json.loads, lines)
    assert set(description) == {"seed", "last", "best"}
    assert [len(policy["any"]) for policy in played] == [9] * len({description["last"], description["best"]})
