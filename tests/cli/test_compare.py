"""`karolos compare` and `karolos diff` over run folders and their index."""

import csv
import io
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select, update
from support import run_samples
from support.commands import karolos, refused, rows
from support.sweep_samples import some_trial, write_sweep

from karolos.records import RunFolder
from karolos.records.sweep_records import SweepFinal
from karolos.specification import load_spec
from karolos.store import Store
from karolos.store.tables import SUCCESSES

A, B = "a1" * 32, "b2" * 32
SPEC = {"name": "reach", "seeds": [0], "environment": {"name": "toy"}, "agent": {"name": "sac", "learning_rate": 1e-3}}


def add_run(runs: Path, seed: int, successes: tuple[int, ...] = (5, 15), **about: Any) -> str:
    about = {"name": "reach", "experiment": A} | about
    return run_samples.add_run(runs, seed, successes, **{"spec": SPEC | {"name": about["name"]}} | about)


@pytest.fixture
def toy(tmp_path):
    path = tmp_path / "toy.yaml"
    path.write_text("environment: toy\nagent: sac\n")
    return path


def test_experiments_are_compared_seed_by_seed(runs):
    for seed, k in enumerate((12, 16)):
        add_run(runs, seed, (4, k))
        add_run(runs, seed, (4, k + 4), name="better", experiment=B)
    first, second = rows("compare", "reach", "better")
    assert (first["label"], first["n"], first["seeds"]) == ("reach", 2, [0, 1])
    assert first["success_any"] == {"value": 0.7, "low": 0.6, "high": 0.8, "kind": "range", "seeds": [0.6, 0.8]}
    assert second["improvement"]["probability"] == (1 + 0.5 + 1 + 1) / 4
    assert first["steps_to_90"] == {"median": None, "reached": 0, "of": 2}
    assert second["seconds_to_50"] == {"median": 20.0, "reached": 2, "of": 2}
    assert [row["parameters"] for row in (first, second)] == [{"name": "reach"}, {"name": "better"}]


def test_experiment_is_named_by_name_hash_spec_file_or_run(runs, toy):
    run = add_run(runs, 0, experiment=load_spec(toy).hash())
    add_run(runs, 0, name="other", experiment=B)
    newest = add_run(runs, 1, name="other", experiment=B)
    for selector, n in ((toy, 1), ("reach", 1), (run, 1), (B[:8], 2), ("other", 2), (newest, 1), ("@last", 1)):
        [row] = rows("compare", selector)
        assert (row["n"], row["experiment"] == B) == (n, selector not in {toy, "reach", run})


def test_of_several_runs_with_one_seed_the_newest_finished_counts_and_one_without_a_test_is_named(runs):
    add_run(runs, 0, (1, 2))
    chosen = add_run(runs, 0, (1, 3))
    add_run(runs, 0, (1, 4), state="failed")
    untested = add_run(runs, 1, (), state="failed")
    [row] = rows("compare", "reach")
    assert row["runs"] == [chosen]
    assert "2 of 4 runs repeat a seed" in row["warnings"][0]
    assert row["warnings"][1] == f"reach: left out, because they have no test: {untested}"


def test_experiment_whose_folders_are_gone_is_compared_from_the_index(runs):
    added = [add_run(runs, seed) for seed in range(2)]
    before = rows("compare", "reach")
    for run in added:
        shutil.rmtree(runs / run)
    assert rows("compare", "reach") == before
    assert before[0]["success_any"]["value"] == 0.75


def test_path_of_a_run_folder_elsewhere_means_its_own_run(runs, tmp_path):
    add_run(runs, 0, (5, 15))
    other = tmp_path / "elsewhere" / "reach-s0"
    shutil.copytree(tmp_path / "elsewhere" / add_run(other.parent, 0, (5, 20)), other)
    assert rows("compare", other)[0]["success_any"]["value"] == 1.0
    shutil.copytree(other.parent / add_run(other.parent, 1, ()), tmp_path / "untested")
    assert "has no test yet" in refused("compare", tmp_path / "untested")


def test_a_policy_that_ships_is_told_to_be_meant(runs):
    add_run(runs, 0)
    folder = RunFolder.create(runs, "panda_pick", 0)  # which the index does not have
    folder.describe(SPEC, experiment=A)
    folder.release()
    told = f"panda_pick: the shipped policy, because the index of {runs} has no run of this name"
    assert told in karolos("compare", "panda_pick").err


def test_where_a_run_has_the_name_of_a_policy_that_ships_a_prefix_means_that(runs):
    add_run(runs, 0, name="panda_pick")
    add_run(runs, 0, name="panda_push")
    [own], [shipped] = (rows("compare", name) for name in ("panda_pick", "shipped:panda_pick"))
    assert own["runs"][0].startswith("panda_pick-s0-")
    assert own["runs"] != shipped["runs"]
    assert "has no run of this name" not in karolos("compare", "shipped:panda_pick").err
    for wrong, near in (
        ("shipped:panda_pck", "did you mean 'shipped:panda_pick'"),
        ("panda_inser", "did you mean 'panda_insert', a shipped policy? `karolos runs list`"),
        ("panda_pck", "did you mean 'panda_pick'?"),
    ):
        said = refused("runs", "show", wrong)
        assert (near in said, said.count("did you mean")) == (True, 1)


def test_name_of_a_best_spec_without_runs_means_the_trial_that_its_sweep_chose(runs):
    write_sweep(runs, "x", [some_trial(0)], SweepFinal(0, (1,), (5,), (0.5, 1), {0: (0.5, 1)}, None))
    for seed in (0, 5):
        add_run(runs, seed, name="x-t000")
    [row] = rows("compare", "x-best")
    assert (row["label"], row["seeds"], len(row["warnings"])) == ("x-t000", [5], 1)
    add_run(runs, 6, name="x-best")
    assert rows("compare", "x-best")[0]["seeds"] == [6]


def test_warnings_go_to_stderr_and_numbers_to_stdout(runs):
    add_run(runs, 0)
    add_run(runs, 0, name="better", experiment=B)
    add_run(runs, 1, name="better", experiment=B, state="stopped")
    told = karolos("compare", "reach", "better")
    assert "0.750 [0.531, 0.888]" in told.out
    assert "settings that differ" in told.out
    assert "warning: unequal numbers of seeds: reach 1; better 2" in told.err
    assert "stopped at 2,000 steps" in told.err


def test_page_and_figures_are_written_in_the_chosen_size_and_keep_their_text(runs, tmp_path):
    for seed in range(2):
        add_run(runs, seed)
    page, figures = tmp_path / "page.html", tmp_path / "figures.2"
    figures.mkdir()
    # tests/report draws the others
    options = ("--figure", "steps", "--width", 2.4, "--font", 6)
    told = karolos("compare", "reach", "--out", page, "--out", figures, *options)
    assert told.err == f"wrote {page}\nwrote 3 files into {figures}\n"
    assert "<svg" in page.read_text()
    assert len(list(figures.iterdir())) == 3
    drawn = (figures / "success_over_steps.svg").read_text()
    assert 'width="172.8pt"' in drawn  # 2.4 inches
    assert ("6px" in drawn, "9px" in drawn) == (True, False)
    assert "success ratio at the end" in drawn


def test_tables_are_written_for_papers_and_spreadsheets(runs, tmp_path):
    add_run(runs, 0)
    add_run(runs, 0, name="better", experiment=B)
    label = '=x_1 & 50 %,"'
    tex, table = tmp_path / "t.tex", tmp_path / "t.csv"
    both = ("compare", "reach", "better", "--label", "a", "--label", label)
    assert f"wrote {table}" in karolos(*both, "--table", tex, "--table", table).err
    written = tex.read_text()
    assert '{} & a & =x\\_1 \\& 50 \\%," \\\\\n\\midrule' in written
    assert "success end & 0.750 [0.531, 0.888] & " in written
    assert "time to 90 \\%, end & -- (0 of 1) & " in written
    assert written.endswith("\\bottomrule\n\\end{tabular}\n")
    first, second = csv.DictReader(io.StringIO(table.read_text()))
    assert (first["label"], second["label"], second["parameters.name"]) == ("a", f"'{label}", "better")
    assert (first["success_end.low"][:5], first["mean_return.value"]) == ("0.531", "-1.5")


def test_densities_are_read_from_the_database(runs):
    for seed, k in enumerate((12, 16, 20)):
        add_run(runs, seed, (4, k))
    before = rows("compare", "reach")[0]["density"]
    with Store(Store.default_url(runs)) as store, store.writing() as connection:
        stored = connection.execute(select(SUCCESSES).order_by(SUCCESSES.c.reported, SUCCESSES.c.steps)).all()
        ratios = [0.6, 0.8, 1.0]
        assert [(row.steps, row.ratios) for row in stored] == [(1000, [0.2] * 3), (2000, ratios), (2000, ratios)]
        connection.execute(update(SUCCESSES).values(mean=0.125))
    assert rows("compare", "reach")[0]["density"] == before | {"mean": 0.125}


def test_experiments_are_called_by_their_labels_and_told_apart_if_they_have_one_name(runs):
    add_run(runs, 0)
    add_run(runs, 1)
    run = add_run(runs, 0, experiment=B)
    both = ("compare", A[:8], B[:8])
    assert [row["label"] for row in rows(*both)] == [f"reach {A[:8]}", run]
    assert [row["label"] for row in rows(*both, "--label", "plain", "--label", "ours")] == ["plain", "ours"]
    for labels in (("--label", "one"), ("--label", "one", "--label", "one")):
        assert "--label: 1 different labels for 2 experiments" in refused(*both, *labels)


def test_arguments_that_cannot_be_meant_are_refused(runs, toy, tmp_path):
    runs.mkdir()
    assert "there are no runs" in refused("compare", "reach")
    run = add_run(runs, 0)
    add_run(runs, 1, experiment=B)
    newest = add_run(runs, 2)
    add_run(runs, 0, (), name="new", experiment="c3" * 32, state="created")
    (tmp_path / "taken").touch()
    page = tmp_path / "no" / "page.html"
    several = f"reach means 2 experiments, whose specs differ, or files that they name; name one by its hash: {A[:12]},"
    for arguments, said in (
        (["reach"], f"{several} {B[:12]}"),
        (["reach", "new", "--label", "with", "--label", "without"], several),
        (["nothing"], "means no run"),
        (["a1a1a1", "a1a1a1a1"], f"'a1a1a1' and 'a1a1a1a1' both mean {newest}; name each"),
        (["a1a1a1", run], f"'a1a1a1' and {run!r} both mean {run}"),
        (["new"], "new has no test yet"),
        ([toy], "there are no runs of"),
        (["a1a1a1", "--figure", "steps"], "--figure: nothing is drawn"),
        (["a1a1a1", "--table", "t.txt"], "--table: cannot write a table into 't.txt'"),
        (
            ["a1a1a1", "--out", "x.txt"],
            "--out: cannot write figures into 'x.txt'; name a file that ends in .html, or a",
        ),
        (["a1a1a1", "--out", page], f"{page}: there is no folder {page.parent}; make it, or name another file\n"),
    ):
        assert said in refused("compare", *arguments)
    taken = ("--out", tmp_path / "taken", "--figure", "steps")
    assert str(tmp_path / "taken") in karolos("compare", "a1a1a1", *taken, code=3).err


def test_diff_shows_what_two_runs_were_made_from(runs):
    one = add_run(runs, 0)
    other = add_run(runs, 1, spec=SPEC | {"seeds": [1], "agent": {"name": "sac", "learning_rate": 1e-4}}, experiment=B)
    assert rows("diff", one, other) == [
        {"part": "run", "key": "seed", "a": 0, "b": 1, "missing": None},
        {"part": "spec", "key": "agent.learning_rate", "a": 1e-3, "b": 1e-4, "missing": None},
    ]
    assert "spec: agent.learning_rate" in karolos("diff", one, other).out
    assert karolos("diff", one, one) == (0, "", "no difference in settings, versions and code\n")


def test_diff_shows_versions_commit_and_changed_files(runs):
    one, other = add_run(runs, 0), add_run(runs, 0)
    path = runs / other / "run.json"
    about = json.loads(path.read_text())
    about["versions"]["torch"] = "1.0"
    path.write_text(json.dumps(about | {"git": {"commit": "abc", "dirty": True}}))
    (runs / one / "code.diff").unlink(missing_ok=True)
    (runs / other / "code.diff").write_text(
        "diff --git a/x.py b/x.py\n--- a/x.py\n+++ b/x.py\n@@ -1 +1 @@\n-a\n+\x1b[2Jb\n"
    )
    found = {(row["part"], row["key"]): row["b"] for row in rows("diff", one, other)}
    assert found == {("version", "torch"): "1.0", ("code", "commit"): "abc", ("code", "x.py"): "changed: +1 -1"}


def test_diff_of_spec_files_leaves_out_what_is_not_a_runs_own(runs, toy):
    other = toy.with_name("other.yaml")
    other.write_text(
        "extends: toy.yaml\ntraining: {steps: 200}\nlauncher: local\n"
        "sweep: {space: {agent.learning_rate: {float: [1e-4, 1e-2]}}}\n"
        "transfer: {variants: {one: {environment.threshold: 0.1}, two: {environment.threshold: 0.2}}}\n"
    )
    found = [(row["key"], row["a"], row["b"]) for row in rows("diff", toy, other)]
    assert found == [("name", "toy", "other"), ("training.steps", 100_000, 200)]
    run = add_run(runs, 0, spec=load_spec(other).alone().dump())
    assert [row["key"] for row in rows("diff", run, other) if row["part"] == "spec"] == []
    missing = toy.with_name("c.yaml")
    assert f"{missing}: there is no such file" in refused("diff", missing, missing)
