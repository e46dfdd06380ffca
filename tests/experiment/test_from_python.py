"""Runs and policies from Python: `karolos.runs`, `karolos.load`, the printed outcome, and columns of `runs list`."""

import re
import shutil
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from support.toy_runs import toy

import karolos
from karolos.errors import SpecError, UsageError
from karolos.specification import load_spec, spec_from_dict

pytestmark = pytest.mark.xdist_group(__name__)

TOY = toy(training={"steps": 40, "replay_ratio": 2}, testing={"interval": 20, "episodes": 4})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("runs")
    karolos.Experiment(TOY).run(path)
    return path


def test_records_and_rows(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    records = karolos.runs("agent=sac and agent.learning_rate<1", runs=folder)
    assert [run.state for run in records] == ["finished"]
    (row,) = records.rows()
    assert (row["run"], row["training.steps"], row["agent"]) == (records[0].run, 40, "sac")
    assert [test["steps"] for test in records.tests()] == [20, 40]
    assert len(karolos.runs("agent=td3", runs=folder)) == 0
    (folder / "empty").mkdir()
    assert len(karolos.runs(runs=folder / "empty")) == 0


def test_an_experiment_takes_the_name_or_the_path_of_a_spec(tmp_path):
    (tmp_path / "reach.yaml").write_text("extends: karolos:panda_reach.yaml\n")
    copied, shipped = karolos.Experiment(tmp_path / "reach.yaml"), karolos.Experiment("karolos:panda_reach")
    assert copied.spec.hash() == shipped.spec.hash()
    with pytest.raises(SpecError, match=r"nothere\.yaml: there is no such file"):
        karolos.Experiment("nothere.yaml")


def test_a_dictionary_stands_for_a_spec_everywhere():
    written = {"environment": {"name": "toy", "dimensions": 2}, "agent": "sac"}
    spec = load_spec(written, ["training.steps=7"])
    assert spec.training.steps == 7
    assert karolos.Experiment(written).spec.hash() == spec_from_dict(written).hash()
    assert karolos.make(written).observation_space["observation"].shape == (2,)


@pytest.mark.parametrize(
    ("ask", "what"),
    [
        (lambda: load_spec(None), "not NoneType"),
        (lambda: karolos.Experiment(["panda_reach"]), "not list"),
        (lambda: spec_from_dict("panda_reach"), "not str; load_spec reads files"),
        (lambda: load_spec("panda_reach", "training.steps=7"), "overrides are a list"),
        (lambda: load_spec("panda_reach", {"training.steps": 7}), "overrides are a list"),
        (lambda: load_spec("panda_reach", [("training.steps", 7)]), "an override is a text, not tuple"),
        (lambda: karolos.Experiment(TOY).run("nowhere", existing="resum"), "'resum'; allowed: ignore, skip, resume"),
        (lambda: karolos.Experiment(TOY).run("nowhere", time_limit="5s"), "'5s', and must be a positive number"),
        (lambda: karolos.Experiment(TOY).run("nowhere", time_limit=float("nan")), "nan, and must be"),
    ],
)
def test_wrong_arguments_are_told_in_one_line(tmp_path, monkeypatch, ask, what):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=what) as error:
        ask()
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


def test_a_missing_index_is_rebuilt_and_a_missing_folder_refused(folder, tmp_path):
    before = karolos.runs(runs=folder)
    copy = shutil.copytree(folder, tmp_path / "copy", ignore=shutil.ignore_patterns("karolos.sqlite"))
    (copy / "damaged").mkdir()
    (copy / "damaged" / "run.json").write_text("{")
    with pytest.warns(UserWarning, match="damaged"):
        assert [run.run for run in karolos.runs(runs=copy)] == [run.run for run in before]
    shutil.rmtree(copy / "damaged")
    (copy / "karolos.sqlite").unlink()
    assert karolos.load("toy", runs=copy).run == before[0].run
    for ask in (karolos.runs, partial(karolos.load, "toy")):
        with pytest.raises(UsageError, match=r"there is no folder .*nowhere; name the runs folder"):
            ask(runs=tmp_path / "nowhere")


def test_rows_are_a_data_frame_where_pandas_is_installed(folder):
    pandas = pytest.importorskip("pandas")
    assert isinstance(karolos.runs(runs=folder).rows(), pandas.DataFrame)


def test_a_loaded_policy_acts_on_one_and_on_many(folder):
    for run in ("@last", karolos.runs(runs=folder)[0].folder):
        policy = karolos.load(run, runs=folder)
        about, shape = str(policy).splitlines()
        assert re.fullmatch(r".* after [\d,]+ steps: success \d\.\d\d in \d+ test episodes", about)
        assert re.fullmatch(r".*: observation \d+, goal \d+ -> action \d+", shape)
        sizes = policy.signature.observation.size, policy.signature.desired_goal.size
        one = policy.act([0.1] * sizes[0], [0.2] * sizes[1])
        many = policy.act(np.full((3, sizes[0]), 0.1), np.full((3, sizes[1]), 0.2))
        assert one.shape == (policy.signature.action.size,)
        np.testing.assert_allclose(many, [one] * 3, atol=1e-6)
    with pytest.raises(UsageError, match="the goal has the shape"):
        policy.act([0.1] * sizes[0])
    with pytest.raises(UsageError, match="the observation has the shape"):
        policy.act([0.1] * (sizes[0] + 1), [0.2] * sizes[1])
    with pytest.raises(UsageError, match="means no run"):
        karolos.load("x" * 300, runs=folder)


def test_an_outcome_prints_as_a_table_and_progress_as_lines(tmp_path, capsys):
    outcome = karolos.Experiment(TOY).run(tmp_path, progress=True)
    told = capsys.readouterr().err.splitlines()
    run = outcome.runs[0].run
    assert [line for line in told if re.match(rf"{run} at 20 steps, \d+\.\d s: success end ", line)]
    assert [line for line in told if line.startswith(f"{run} final test: success end ")]
    assert told[-1] == f"{run} finished"
    head, line = str(outcome).splitlines()
    assert head.split() == ["run", "state", "steps", "return", "success", "end", "seconds"]
    assert line.split()[:3] == [outcome.runs[0].run, "finished", "40"]
