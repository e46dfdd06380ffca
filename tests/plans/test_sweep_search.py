"""Sweeps from the first trial to the best spec, with processes that die on the way."""

import json
import os
import shutil
import signal
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support.fake_launcher import FakeLauncher
from support.fork_server import FORKS
from support.processes import child_processes, killed_when
from support.sweep_samples import LEARNING_RATE, sweep_spec
from support.toy_runs import run_of

from karolos.comparison import gather
from karolos.errors import NoSuchRunError, RunError, UsageError
from karolos.experiment.events import RunWarned
from karolos.launchers.experiment import Outcome
from karolos.launchers.runs import Home, RunJob
from karolos.plans.objectives import measure_all
from karolos.plans.study import Study
from karolos.plans.sweep import Search
from karolos.records import RunFolder
from karolos.records.sweep_records import FinalBegan, SweepRecord, TrialChanged, find_sweep, read_sweep
from karolos.specification import load_spec, spec_from_dict, spec_of_trial
from karolos.store import Store, check, query, reindex
from karolos.system.files import FileLock

pytestmark = pytest.mark.xdist_group(__name__)

TRIALS = 5
SPEC = sweep_spec(
    LEARNING_RATE,
    trials=TRIALS,
    objective="mean_success_end",
    final={"top": 2, "seeds": 1, "report_seeds": 1},
) | {"seeds": [2]}
BEGIN = FORKS + "import json, sys; from karolos.plans.sweep import Search\nif __name__ == '__main__':\n    "
BEGIN += "Search(json.loads(sys.argv[1])).run('runs')"


def searched(spec: Any, runs: Path, **options: Any) -> tuple[SweepRecord, Outcome]:
    """The sweep of a spec after a call of it."""
    search = Search(spec)
    outcome = search.run(runs, **options)
    assert search.record is not None
    return search.record, outcome


@pytest.fixture
def plain(monkeypatch) -> None:
    """Runs in this process, one after the other, and no figures, which take longer than the trials."""
    monkeypatch.setattr("karolos.plans.plan.make_launcher", lambda *_: FakeLauncher())
    monkeypatch.setattr(Study, "figures", lambda _: {})


@pytest.fixture(scope="module")
def killed(tmp_path_factory) -> SweepRecord:
    """A sweep whose process was killed half-way, and that was then started again and lost a worker."""
    home = tmp_path_factory.mktemp("killed")
    command = [sys.executable, "-c", BEGIN, json.dumps(SPEC)]
    trials = home / "runs" / "sweeps" / "line" / "trials.jsonl"
    killed_when(lambda: trials.exists() and len(trials.read_text().splitlines()) >= 2, command, alone=True, cwd=home)
    assert 2 <= len(trials.read_text().splitlines()) < TRIALS
    lost: list[int] = []
    others = set(child_processes())  # of earlier tests

    def kill(event: object) -> None:
        if isinstance(event, TrialChanged) and event.trial.state == "running" and not lost:
            lost.extend(set(child_processes()) - others)  # none at the first trial
            for process in lost:
                os.kill(process, signal.SIGKILL)

    found, outcome = searched(SPEC, home / "runs", listener=kill)
    assert len(lost) == 1
    assert outcome.complete
    return found


@pytest.fixture
def store(killed) -> Iterator[Store]:
    """The database of that sweep."""
    with Store(Store.default_url(Path(killed.folder).parents[1])) as opened:
        yield opened


def test_a_sweep_that_was_killed_and_lost_a_worker_ends_with_its_trials_and_none_is_doubled(killed):
    assert [trial.number for trial in killed.trials] == list(range(TRIALS))
    assert {trial.state for trial in killed.trials} == {"complete"}
    runs = Path(killed.folder).parents[1]
    folders = [RunFolder.open(path.parent) for path in runs.glob("line-t*/run.json")]
    made = Counter((folder.description()["name"], folder.description()["seed"]) for folder in folders)
    assert max(made.values()) == 1
    assert {f"line-t{number:03}" for number in range(TRIALS)} == {name for name, _ in made}
    assert all(folder.state().state == "finished" for folder in folders)
    assert sum(seed == 0 for _, seed in made) == TRIALS


def test_a_sweep_finds_a_better_learning_rate_than_a_bad_default(killed, tmp_path):
    found = [test.success_end for test in run_of({**SPEC, "sweep": None, "seeds": [0]}, tmp_path).tests()]
    assert killed.best.values[0] > sum(found) / len(found) + 0.2
    assert killed.best.drawn["agent.learning_rate"] > 1e-4


def test_the_best_is_chosen_and_reported_on_seeds_and_test_episodes_it_was_not_tuned_on(killed):
    final, runs = killed.final, Path(killed.folder).parents[1]
    assert (final.seeds, final.report_seeds) == ((1,), (3,))  # 0 tuned it, and 2 is the spec's own
    assert len(final.fresh) == 2
    assert final.fresh[final.chosen] == max(final.fresh.values())
    row = json.loads((Path(killed.folder) / "final.json").read_text())
    assert row["gap"] == pytest.approx([final.tuned[0] - final.reported[0]])
    tuned, chosen, reported = (RunFolder.open(next(runs.glob(f"{killed.best.name}-s{seed}-*"))) for seed in (0, 1, 3))
    assert [folder.spec()["testing"]["seed"] for folder in (tuned, chosen, reported)] == [0, 0, 2_000_000]
    assert [bool(folder.final()) for folder in (tuned, chosen, reported)] == [False, False, True]


def test_the_best_trial_is_a_spec_that_runs_and_is_reported_by_its_final_test(killed):
    spec = load_spec(Path(killed.folder) / "best.yaml")
    assert spec.agent.settings.learning_rate == killed.best.drawn["agent.learning_rate"]
    assert (spec.name, spec.seeds, spec.sweep) == ("line-best", killed.final.report_seeds, None)
    folder = RunFolder.open(next(Path(killed.folder).parents[1].glob(f"{killed.best.name}-s3-*")))
    assert folder.description()["experiment"] == spec.hash()
    job = RunJob(spec, Home(folder.path.parent, ""), known={3: folder})
    assert list(job.tasks()) == []
    values = measure_all(("success_end", "return"), job)
    assert values == (folder.final()["last"].success_end, folder.final()["last"].mean_return)


def test_only_runs_on_reporting_seeds_are_compared_whatever_their_name(killed, store):
    trial = store.runs(name=killed.best.name)
    best = [replace(run, name="line-best") for run in trial]
    tuned = [run for run in best if run.seed < 3]
    for runs in (trial, [*trial, *tuned]):
        gathered = gather(store, runs, "both")
        assert [run.summary.seed for run in gathered.runs] == [3]
        only = "only the seeds that the sweep line reports on count; it tuned or chose the settings on 0, 1"
        assert gathered.problems[0].endswith(only)
    assert gather(store, [run for run in best if run.seed == 3], "reported").problems == ()
    other = next(trial for trial in killed.trials if trial.number != killed.best.number)
    for biased in (store.runs(name=other.name), tuned, [*trial, *tuned]):
        [problem, *_] = gather(store, [run for run in biased if run.seed == 0], "both").problems
        assert problem.startswith("both: the sweep line tuned or chose its settings by these runs")
        assert "biased upwards" in problem


def test_without_runs_the_name_of_the_best_spec_means_the_chosen_trial_or_says_how_to_make_them(copied):
    with Store(Store.default_url(copied)) as store:
        sweep = find_sweep(copied, "line")
        assert query.select(store, "line-best", or_trial=True) == store.runs(name=sweep.best.name)
        made = rf"'line-best' means no run; `karolos run {sweep.folder}/best.yaml` makes them"
        with pytest.raises(NoSuchRunError, match=made):
            query.find(store, "line-best")
        (copied / "sweeps" / "line" / "final.json").unlink()
        with pytest.raises(NoSuchRunError, match=made):
            query.select(store, "line-best", or_trial=True)


@pytest.fixture
def copied(killed, tmp_path) -> Path:
    """The runs folder of that sweep, once more."""
    runs = Path(killed.folder).parents[1]
    shutil.copytree(runs, tmp_path / "runs", ignore=shutil.ignore_patterns("*.sqlite*"))
    with Store(Store.default_url(tmp_path / "runs")) as store:
        reindex(store, tmp_path / "runs")
    return tmp_path / "runs"


MORE = SPEC | {"sweep": SPEC["sweep"] | {"final": SPEC["sweep"]["final"] | {"seeds": 2}}}


@pytest.mark.usefixtures("plain")
def test_without_a_final_phase_the_best_spec_has_seeds_and_episodes_that_tuned_nothing(copied):
    (copied / "sweeps" / "line" / "final.json").unlink()
    outcome, _ = searched(SPEC | {"sweep": SPEC["sweep"] | {"final": None}}, copied)
    best = load_spec(Path(outcome.folder) / "best.yaml")
    assert outcome.final is None
    assert best.seeds == (1,)  # 0 tuned it, and 2 is the spec's own
    assert best.testing.seed == 2_000_000


def test_a_call_that_is_stopped_in_the_final_phase_keeps_that_of_an_earlier_one(killed, copied):
    def stop(event: object) -> None:
        if isinstance(event, FinalBegan):
            os.kill(os.getpid(), signal.SIGTERM)

    stopped, outcome = searched(MORE, copied, listener=stop)
    assert outcome.exit_code == 143
    assert stopped.final == killed.final
    assert read_sweep(Path(stopped.folder))[0].final == killed.final


@pytest.mark.usefixtures("plain")
def test_no_seed_that_the_best_was_chosen_by_reports_on_it_later(copied):
    found = [searched(spec, copied)[0].final for spec in (MORE, SPEC)]
    assert (found[0].seeds, found[1].report_seeds) == ((1, 3), (4,))


@pytest.mark.usefixtures("plain")
def test_a_sweep_that_has_its_trials_runs_nothing_more(killed):
    before = {path: path.stat().st_mtime_ns for path in Path(killed.folder).parents[1].glob("line-t*/tests.jsonl")}
    again, _ = searched(SPEC, Path(killed.folder).parents[1])
    assert again.trials == killed.trials
    assert again.final == killed.final
    after = {path: path.stat().st_mtime_ns for path in Path(killed.folder).parents[1].glob("line-t*/tests.jsonl")}
    assert after == before


def test_the_folder_says_it_all_without_optuna(killed):
    rows = [json.loads(line) for line in (Path(killed.folder) / "trials.jsonl").read_text().splitlines()]
    assert [row["number"] for row in rows] == list(range(TRIALS))
    assert all(len(row["runs"]) == 1 and row["values"] for row in rows)
    assert spec_from_dict(SPEC) == load_spec(Path(killed.folder) / "sweep.yaml")
    assert (Path(killed.folder) / "figures" / "parallel.svg").read_text().count("agent.learning_rate") >= 1


@pytest.mark.usefixtures("plain")
def test_the_folder_knows_of_trials_as_they_begin_and_end_and_their_runs_are_marked(tmp_path):
    heard = []

    def listen(event: object) -> None:
        if not isinstance(event, RunWarned):
            heard.append([trial.state for trial in find_sweep(tmp_path, "line").trials])

    spec = sweep_spec({"agent.learning_rate": {"choice": [1e-3, 1e-2]}}, sampler="grid") | {
        "training": {"steps": 8, "batch_size": 4}
    }
    outcome, _ = searched(spec, tmp_path, listener=listen)
    assert heard == [["running"], ["complete"], ["complete", "running"], ["complete", "complete"]]
    found = find_sweep(tmp_path, outcome.sweep)
    assert (found.trials, found.final, found.state()) == (outcome.trials, outcome.final, "finished")
    with Store(Store.default_url(tmp_path)) as store:
        assert {run.run for run in store.runs(trials=True)} == {run for one in found.trials for run in one.runs}
        assert (store.runs(trials=False), list(check(store, tmp_path))) == ((), [])


def test_another_search_of_the_same_name_is_refused(killed):
    runs = Path(killed.folder).parents[1]
    with pytest.raises(UsageError, match="other settings"):
        Search({**SPEC, "sweep": {**SPEC["sweep"], "objective": "success_any"}}).run(runs)
    lock = FileLock(Path(killed.folder) / "lock")
    assert lock.acquire()
    with pytest.raises(RunError, match="another process"):
        Search(SPEC).run(runs)
    lock.release()


@pytest.fixture(scope="module")
def grid(tmp_path_factory) -> SweepRecord:
    """A sweep on two seeds, of whose trials most are no good; it was asked to stop at the first, and begun again."""
    space = {
        "agent.learning_rate": {"choice": [1e-1, 1e-6, 1e30]},  # the last leads to losses that are no numbers
        "training.batch_size": {"choice": [32, 4000]},  # the second is more than the buffer holds
    }
    spec = sweep_spec(space, seeds=[0, 1], sampler="grid", objective="mean_success_any", pruner={"startup": 1})
    agent = {**spec["agent"], "precision": "float32"}
    spec = {**spec, "agent": agent, "training": {**spec["training"], "steps": 400, "replay_ratio": 16}}
    runs = tmp_path_factory.mktemp("grid")

    def stop(event: object) -> None:
        if isinstance(event, TrialChanged) and event.trial.state == "running":
            os.kill(os.getpid(), signal.SIGTERM)

    stopped, outcome = searched(spec, runs, listener=stop)
    assert ([trial.state for trial in stopped.trials], outcome.exit_code) == (["running"], 143)
    assert not (Path(stopped.folder) / "figures").exists()
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Study, "figures", lambda _: {})  # they take longer than the trials; `killed` draws them
        found, outcome = searched(spec, runs)
    assert outcome.exit_code == 0
    return found


def test_a_stopped_sweep_goes_on_and_trials_that_cannot_work_fail(grid):
    assert [trial.state for trial in grid.trials] == ["complete", "failed", "pruned", "failed", "failed", "failed"]
    assert all("batch" in grid.trials[number].error for number in (1, 3, 5))
    assert "nan" in grid.trials[4].error or "inf" in grid.trials[4].error
    assert grid.best.number == 0


def test_a_pruned_trials_runs_are_stopped_and_say_why(grid):
    runs = [RunFolder.open(Path(grid.folder).parents[1] / run) for run in grid.trials[2].runs]
    assert [run.description()["seed"] for run in runs] == [0, 1]
    assert "stopped" in [run.state().state for run in runs]
    for run in runs:
        if run.state().state == "stopped":  # the other may have been at its end already
            assert run.events()[-1]["reason"] == "pruned"
            assert 0.3 * 400 <= run.state().steps <= 400  # all of them if it was stopped in its last test


def test_a_trials_value_is_the_mean_over_its_seeds(grid):
    runs = [RunFolder.open(Path(grid.folder).parents[1] / run) for run in grid.trials[0].runs]
    means = [sum(test.success_any for test in run.tests()) / len(run.tests()) for run in runs]
    assert len(means) == 2
    assert grid.trials[0].values == pytest.approx((sum(means) / 2,))


def test_a_spec_without_a_sweep_is_refused():
    with pytest.raises(UsageError, match="no sweep"):
        Search({key: value for key, value in SPEC.items() if key != "sweep"})
    with pytest.raises(UsageError, match="58 characters"):
        Search({**SPEC, "name": "x" * 59})


def test_an_experiment_leaves_the_sweep_of_its_spec_alone(tmp_path):
    assert "sweep" not in run_of({**SPEC, "training": {"steps": 4, "batch_size": 4}}, tmp_path).spec()


def test_another_plugin_keeps_the_settings_that_both_have():
    space = {
        "agent.name": {"choice": ["sac", "td3"]},
        "buffer.name": {"choice": ["uniform", "priority"]},
        "buffer.hindsight.ratio": {"float": [0.5, 0.9]},
    }
    spec = sweep_spec(space)
    spec["buffer"] |= {"hindsight": {"strategy": "final"}, "n_step": 3}
    spec["agent"]["random_actions"] = 0.1  # the default of sac, and not of td3
    drawn = {"agent.name": "td3", "buffer.name": "priority", "buffer.hindsight.ratio": 0.6}
    trial = spec_of_trial(spec_from_dict(spec), drawn, "t", (0,), "trial 0").changed()
    assert trial["agent"] == spec["agent"] | {"name": "td3"}
    hindsight = {"strategy": "final", "ratio": 0.6}
    assert trial["buffer"] == {"name": "priority", "capacity": 2000, "hindsight": hindsight, "n_step": 3}


def test_samples_are_specs_of_trials_and_values_that_clash_are_told():
    found = list(Search(SPEC).samples(3))
    assert [made.name for _, made in found] == ["line-t000", "line-t001", "line-t002"]
    assert all(made.agent.settings.learning_rate == drawn["agent.learning_rate"] for drawn, made in found)
