"""A run in an environment that does not define success: returns stand where success stands elsewhere."""

import io
import json
from pathlib import Path
from typing import Any

import karolos_cli.runs
import pytest
from karolos_cli.compare import compare
from karolos_cli.display import Plain
from karolos_cli.policy import play
from support.commands import call
from support.run_samples import stored
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from typer import Typer

from karolos.evaluation.zero_shot import zero_shot_test
from karolos.experiment.checkpointer import _rank
from karolos.launchers.experiment import Experiment
from karolos.records import RunFolder, checkpoint
from karolos.records.evaluation import Evaluation
from karolos.records.run_records import RunSummary
from karolos.report.tables import transfers_table
from karolos.store import Store, query, reindex

pytestmark = pytest.mark.xdist_group(__name__)

PENDULUM: dict[str, Any] = {
    "name": "pendulum",
    "environment": {"name": "gymnasium", "id": "Pendulum-v1", "max_steps": 5},
    "agent": {"name": "ddpg", "hidden": [8]},
    "orchestrator": {"processes": 0, "environments": 2},
    "training": {"steps": 60, "batch_size": 8, "replay_ratio": 4, "warmup_episodes": 2},
    "testing": {"interval": 20, "episodes": 3, "final_episodes": 4},
}
app = Typer()
app.command()(compare)
app.command()(play)


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> tuple[RunSummary, list[str]]:
    """A finished run, and the lines that it printed."""
    stream = io.StringIO()
    outcome = Experiment(PENDULUM).run(tmp_path_factory.mktemp("runs"), listener=Plain(stream))
    return outcome.runs[0], stream.getvalue().splitlines()


@pytest.fixture(scope="module")
def run(told: tuple[RunSummary, list[str]]) -> RunSummary:
    return told[0]


def test_records_and_index_hold_returns_and_no_success(run):
    folder = RunFolder.open(run.folder)
    assert (run.mean_return, run.best_return) == tuple(one.mean_return for one in folder.final().values())
    unknown = ("success_any", "success_end", "best_any", "best_end", "steps_to_95", "seconds_to_95", "steps_to_95_any")
    assert [getattr(run, name) for name in unknown] == [None] * len(unknown)
    with Store(Store.default_url(folder.path.parent)) as store:
        for _ in range(2):
            assert query.find(store, run.run) == run
            assert [test.mean_return for test in stored(store, run.run).tests] == [
                one.mean_return for one in folder.tests()
            ]
            assert {test.successes_end for test in stored(store, run.run).tests} == {None}
            assert len(store.runs(where="mean_return < 0")) == 1
            reindex(store, folder.path.parent)


def test_best_is_the_policy_of_the_highest_return(run):
    folder = RunFolder.open(run.folder)
    best = max(folder.tests(), key=lambda test: test.mean_return)
    meta = checkpoint.read_meta(folder.checkpoints, "best")
    assert (meta["steps"], meta["chosen_by"]) == (best.steps, {"mean_return": best.mean_return})


def test_any_return_is_better_than_one_that_is_not_finite():
    infinite, low, high = (Evaluation(0, 0.0, 1, None, None, None, mean_return) for mean_return in (None, -1e30, -1.0))
    assert sorted((high, infinite, low), key=_rank) == [infinite, low, high]


def test_lines_of_a_run_and_series_say_returns_only(told):
    run, lines = told
    assert sum(": return -" in line for line in lines) == 4
    assert not any("success" in line for line in lines)
    assert f"; best return {run.best_return:,.2f}" in lines[-2]
    series = EventAccumulator(str(RunFolder.open(run.folder).tensorboard))
    series.Reload()
    tags = series.Tags()["scalars"]
    assert {"test/return", "train/return"} <= set(tags)
    assert not [tag for tag in tags if "success" in tag]


def test_tables_show_returns_only(run):
    runs = ("--runs", str(Path(run.folder).parent))
    for command in (("list",), ("show", run.run)):
        code, out, _ = call(karolos_cli.runs.app, *command, *runs)
        assert code == 0
        assert f"{run.mean_return:,.2f}" in out
        assert "success end" not in out
    _, out, _ = call(karolos_cli.runs.app, "show", run.run, *runs, "--json")
    last = json.loads(out)["final_test"]["last"]
    assert (last["success_end"], last["success_end_interval"], last["mean_return"]) == (None, None, run.mean_return)
    table = transfers_table([zero_shot_test(RunFolder.open(run.folder), checkpoint="last")])
    assert not any("success" in name or name.endswith(" any") for name in table.columns)
    assert table.rows[0][table.columns.index("return")] == f"{run.mean_return:,.2f}"


def test_compare_shows_returns_by_default_and_refuses_to_compare_success(run, tmp_path):
    where = (run.run, "--runs", str(Path(run.folder).parent))
    code, out, _ = call(app, "compare", *where, "--out", str(tmp_path))
    assert code == 0
    assert f"{run.mean_return:.3f}" in out
    assert "success" not in out.replace("exist for success only", "")
    assert "return_over_steps.svg" in {path.name for path in tmp_path.iterdir()}
    code, _, err = call(app, "compare", *where, "--metric", "end")
    assert (code, "does not define success" in err) == (2, True)


def test_play_says_the_return(run, tmp_path):
    pytest.importorskip("pygame")
    film = ("--record", str(tmp_path / "film.gif"), "--width", "64", "--height", "48")
    code, _, err = call(app, "play", run.folder, *film)
    assert code == 0, err
    assert err.startswith("episode 1: over after 5 steps, return -")
