"""The final test of a run: its episodes, its policies, where it is stored, and what a kill leaves of it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support import toy_runs

from karolos.evaluation import due_tests
from karolos.evaluation.policies import load_agent
from karolos.evaluation.testing import play_episodes, test_seeds
from karolos.experiment.events import RunFinalTested
from karolos.launchers.experiment import Experiment, Outcome, resume_run
from karolos.records import RunFolder
from karolos.records.run_folder import FINAL as FILE
from karolos.specification import spec_from_dict
from karolos.store import Store, query, reindex
from karolos.training.assembly import make_orchestrator

pytestmark = pytest.mark.xdist_group(__name__)

TOY = toy_runs.toy(training={"steps": 120}, testing={"interval": 20, "episodes": 4, "final_episodes": 9, "seed": 3})


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    return Experiment(TOY | {"seeds": [0, 1]}).run(tmp_path_factory.mktemp("runs"))


def folder_of(outcome: Outcome, place: int = 0) -> RunFolder:
    return RunFolder.open(outcome.runs[place].folder)


def test_a_run_ends_with_a_test_of_last_and_best_on_episodes_that_no_other_test_played(outcome):
    folder = folder_of(outcome)
    seed = 3 + 1_000_000
    assert list(folder.final()) == ["last", "best"]
    assert not set(test_seeds(seed, 9)) & set(test_seeds(3, 4))
    for name, result in folder.final().items():
        saved = load_agent(folder, name)
        with make_orchestrator(saved.spec, randomize=False) as environments:
            again = play_episodes(environments, saved.agent, test_seeds(seed, 9), steps=saved.steps)
        about = {"checkpoint": name, "sha256": saved.sha256, "seed": seed}
        assert replace(result, seconds=0.0) == replace(again, **about)
        assert result.episodes == 9


def test_the_reported_success_is_that_of_the_final_test_in_the_folder_and_the_index(outcome):
    for summary in outcome.runs:
        last, best = RunFolder.open(summary.folder).final().values()
        assert (summary.success_any, summary.success_end) == (last.success_any, last.success_end)
        assert (summary.episodes, summary.final) == (9, True)
        assert (summary.best_steps, summary.best_end) == (best.steps, best.success_end)
        with Store(Store.default_url(Path(summary.folder).parent)) as store:
            assert query.find(store, summary.run) == summary
            reindex(store, Path(summary.folder).parent)
            assert query.find(store, summary.run) == summary


def test_its_event_comes_once_it_is_written(tmp_path):
    seen = []

    def listen(event: object) -> None:
        if isinstance(event, RunFinalTested):
            [path] = tmp_path.glob(f"*/{FILE}")
            seen.append((event.final, RunFolder.open(path.parent).final()))

    Experiment(TOY).run(tmp_path, listener=listen)
    [(told, written)] = seen
    assert told == written


def test_the_best_policy_is_tested_where_the_last_could_not_be_saved(tmp_path, monkeypatch):
    toy_runs.fill_disk(monkeypatch, lambda name: name != "last")
    summary = toy_runs.run_of(TOY, tmp_path).summary()
    assert summary.state == "failed"
    last, best = RunFolder.open(summary.folder).final().values()
    assert (last.sha256, bool(best.sha256)) == ("", True)
    assert summary.best_steps == best.steps


def test_no_final_test_without_final_episodes(tmp_path):
    folder = toy_runs.run_of(toy_runs.toy(TOY, testing={"final_episodes": 0}), tmp_path)
    summary = folder.summary()
    assert folder.final() == {}
    assert not (folder.path / FILE).exists()
    assert (summary.final, summary.best_end) == (False, None)
    assert summary.success_end == folder.tests()[-1].success_end


def test_null_plays_as_many_episodes_as_a_test_and_is_the_same_experiment():
    testing = {"interval": 20, "episodes": 4}
    absent = spec_from_dict(TOY | {"testing": testing})
    assert absent.testing.final_count == 4
    assert absent.hash() == spec_from_dict(TOY | {"testing": testing | {"final_episodes": 4}}).hash()
    assert absent.hash() != spec_from_dict(TOY | {"testing": testing | {"final_episodes": 5}}).hash()


def test_a_run_killed_in_its_final_test_plays_it_on_resume(tmp_path, outcome, monkeypatch):
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
    assert folder.final() == {}
    assert folder.state().state == "stopped"
    [summary] = resume_run(folder, Store.default_url(tmp_path)).runs
    assert summary.state == "finished"
    ours, theirs = (
        [replace(one, seconds=0.0, sha256=None) for one in each.final().values()]
        for each in (folder, folder_of(outcome))
    )
    assert ours == theirs


@pytest.mark.parametrize("damage", [lambda text: text[:-40], lambda text: "{}\n", lambda text: text.splitlines()[0]])
def test_a_damaged_file_is_named_and_the_last_test_counts_instead(outcome, damage):
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
