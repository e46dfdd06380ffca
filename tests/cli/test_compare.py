"""`karolos compare` and `karolos diff` over run folders and their index."""

import csv
import io
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import typer
from karolos_cli.compare import compare, diff
from sqlalchemy import select, update
from support import run_samples
from support.commands import call
from support.sweep_samples import some_trial, write_sweep

from karolos.errors import NoSuchRunError
from karolos.records import RunFolder
from karolos.records.sweep_records import SweepFinal
from karolos.specification import load_spec
from karolos.store import Store
from karolos.store.query import find_meant
from karolos.store.tables import SUCCESSES

A, B = "a1" * 32, "b2" * 32
SPEC = {"name": "reach", "seeds": [0], "environment": {"name": "toy"}, "agent": {"name": "sac", "learning_rate": 1e-3}}

app = typer.Typer()
app.command()(compare)
app.command()(diff)


def add_run(runs: Path, seed: int, successes: tuple[int, ...] = (5, 15), **about: Any) -> str:
    about = {"name": "reach", "experiment": A} | about
    return run_samples.add_run(runs, seed, successes, **{"spec": SPEC | {"name": about["name"]}} | about)


def rows(*arguments: object) -> list[dict[str, Any]]:
    code, out, err = call(app, *map(str, arguments), "--json")
    assert code == 0, err
    return [json.loads(line) for line in out.splitlines()]


def refused(*arguments: object) -> str:
    code, out, err = call(app, *map(str, arguments))
    assert (code, out) == (2, "")
    return err


def test_experiments_are_compared_seed_by_seed(runs):
    for seed, k in enumerate((12, 16)):
        add_run(runs, seed, (4, k))
        add_run(runs, seed, (4, k + 4), name="better", experiment=B)
    first, second = rows("compare", "reach", "better", "--runs", runs)
    assert (first["label"], first["n"], first["seeds"]) == ("reach", 2, [0, 1])
    assert first["success_any"] == {"value": 0.7, "low": 0.6, "high": 0.8, "kind": "range", "seeds": [0.6, 0.8]}
    assert second["improvement"]["probability"] == (1 + 0.5 + 1 + 1) / 4
    assert first["steps_to_90"] == {"median": None, "reached": 0, "of": 2}
    assert second["seconds_to_50"] == {"median": 20.0, "reached": 2, "of": 2}
    assert [row["parameters"] for row in (first, second)] == [{"name": "reach"}, {"name": "better"}]


def test_experiment_is_named_by_name_hash_spec_file_or_run(runs, tmp_path):
    file = tmp_path / "toy.yaml"
    file.write_text("environment: toy\nagent: sac\n")
    run = add_run(runs, 0, experiment=load_spec(file).hash())
    add_run(runs, 0, name="other", experiment=B)
    newest = add_run(runs, 1, name="other", experiment=B)
    for selector, n in ((file, 1), ("reach", 1), (run, 1), (B[:8], 2), ("other", 2), (newest, 1), ("@last", 1)):
        [row] = rows("compare", selector, "--runs", runs)
        assert (row["n"], row["experiment"] == B) == (n, selector not in {file, "reach", run})


def test_of_several_runs_with_one_seed_the_newest_finished_counts_and_one_without_a_test_is_named(runs):
    add_run(runs, 0, (1, 2))
    chosen = add_run(runs, 0, (1, 3))
    add_run(runs, 0, (1, 4), state="failed")
    untested = add_run(runs, 1, (), state="failed")
    [row] = rows("compare", "reach", "--runs", runs)
    assert row["runs"] == [chosen]
    assert "2 of 4 runs repeat a seed" in row["warnings"][0]
    assert row["warnings"][1] == f"reach: left out, because they have no test: {untested}"


def test_experiment_whose_folders_are_gone_is_compared_from_the_index(runs):
    added = [add_run(runs, seed) for seed in range(2)]
    before = rows("compare", "reach", "--runs", runs)
    for run in added:
        shutil.rmtree(runs / run)
    assert rows("compare", "reach", "--runs", runs) == before
    assert before[0]["success_any"]["value"] == 0.75


def test_path_of_a_run_folder_elsewhere_means_its_own_run(runs, tmp_path):
    add_run(runs, 0, (5, 15))
    other = tmp_path / "elsewhere" / "reach-s0"
    shutil.copytree(tmp_path / "elsewhere" / add_run(other.parent, 0, (5, 20)), other)
    assert rows("compare", other, "--runs", runs)[0]["success_any"]["value"] == 1.0
    shutil.copytree(other.parent / add_run(other.parent, 1, ()), tmp_path / "untested")
    assert "has no test yet" in refused("compare", tmp_path / "untested", "--runs", runs)


def test_a_policy_that_ships_is_told_to_be_meant(runs):
    add_run(runs, 0)
    folder = RunFolder.create(runs, "panda_pick", 0)  # which the index does not have
    folder.describe(SPEC, experiment=A)
    folder.release()
    code, _, err = call(app, "compare", "panda_pick", "--runs", str(runs))
    assert code == 0
    assert f"panda_pick: the shipped policy, because the index of {runs} has no run of this name" in err


def test_where_a_run_has_the_name_of_a_policy_that_ships_a_prefix_means_that(runs):
    add_run(runs, 0, name="panda_pick")
    [own], [shipped] = (rows("compare", name, "--runs", runs) for name in ("panda_pick", "shipped:panda_pick"))
    assert own["runs"][0].startswith("panda_pick-s0-")
    assert own["runs"] != shipped["runs"]
    assert "has no run of this name" not in call(app, "compare", "shipped:panda_pick", "--runs", str(runs))[2]
    with Store(Store.default_url(runs)) as store, pytest.raises(NoSuchRunError) as caught:
        find_meant("shipped:panda_pck", store, runs)
    assert "did you mean 'shipped:panda_pick'" in str(caught.value.hint)
    add_run(runs, 0, name="panda_push")
    with Store(Store.default_url(runs)) as store, pytest.raises(NoSuchRunError) as caught:
        find_meant("panda_inser", store, runs)
    assert str(caught.value.hint).startswith("did you mean 'panda_insert', a shipped policy? `karolos runs list`")
    with Store(Store.default_url(runs)) as store, pytest.raises(NoSuchRunError) as caught:
        find_meant("panda_pck", store, runs)
    assert (
        str(caught.value.hint).count("did you mean") == str(caught.value.hint).count("did you mean 'panda_pick'?") == 1
    )


def test_name_of_a_best_spec_without_runs_means_the_trial_that_its_sweep_chose(runs):
    write_sweep(runs, "x", [some_trial(0)], SweepFinal(0, (1,), (5,), (0.5, 1), {0: (0.5, 1)}, None))
    for seed in (0, 5):
        add_run(runs, seed, name="x-t000")
    [row] = rows("compare", "x-best", "--runs", runs)
    assert (row["label"], row["seeds"], len(row["warnings"])) == ("x-t000", [5], 1)
    add_run(runs, 6, name="x-best")
    assert rows("compare", "x-best", "--runs", runs)[0]["seeds"] == [6]


def test_warnings_go_to_stderr_and_numbers_to_stdout(runs):
    add_run(runs, 0)
    add_run(runs, 0, name="better", experiment=B)
    add_run(runs, 1, name="better", experiment=B, state="stopped")
    code, out, err = call(app, "compare", "reach", "better", "--runs", str(runs))
    assert code == 0
    assert "0.750 [0.531, 0.888]" in out
    assert "settings that differ" in out
    assert "warning: unequal numbers of seeds: reach 1; better 2" in err
    assert "stopped at 2,000 steps" in err


def test_page_and_figures_are_written_in_the_chosen_size_and_keep_their_text(runs, tmp_path):
    for seed in range(2):
        add_run(runs, seed)
    page, figures = tmp_path / "page.html", tmp_path / "figures.2"
    figures.mkdir()
    options = ("--out", str(page), "--out", str(figures), "--width", "2.4", "--font", "6")
    code, _, err = call(app, "compare", "reach", "--runs", str(runs), *options)
    assert (code, err) == (0, f"wrote {page}\nwrote 12 files into {figures}\n")
    assert "<svg" in page.read_text()
    assert len(list(figures.iterdir())) == 12  # no profile of seeds that are alike
    drawn = (figures / "success_over_steps.svg").read_text()
    assert 'width="172.8pt"' in drawn  # 2.4 inches
    assert ("6px" in drawn, "9px" in drawn) == (True, False)
    assert "success ratio at the end" in drawn


def test_tables_are_written_for_papers_and_spreadsheets(runs, tmp_path):
    add_run(runs, 0)
    add_run(runs, 0, name="better", experiment=B)
    label = '=x_1 & 50 %,"'
    files = [str(tmp_path / f"t.{end}") for end in ("tex", "csv", "txt")]
    options = ("--runs", str(runs), "--label", "a", "--label", label)
    code, _, err = call(app, "compare", "reach", "better", *options, "--table", files[0], "--table", files[1])
    assert (code, f"wrote {files[1]}" in err) == (0, True)
    tex = Path(files[0]).read_text()
    assert '{} & a & =x\\_1 \\& 50 \\%," \\\\\n\\midrule' in tex
    assert "success end & 0.750 [0.531, 0.888] & " in tex
    assert "time to 90 \\%, end & -- (0 of 1) & " in tex
    assert tex.endswith("\\bottomrule\n\\end{tabular}\n")
    first, second = csv.DictReader(io.StringIO(Path(files[1]).read_text()))
    assert (first["label"], second["label"], second["parameters.name"]) == ("a", f"'{label}", "better")
    assert (first["success_end.low"][:5], first["mean_return.value"]) == ("0.531", "-1.5")
    assert "--table: cannot write a table into 't.txt'" in refused(
        "compare", "reach", *options[:2], "--table", files[2]
    )
    assert "--figure: nothing is drawn" in refused("compare", "reach", *options[:2], "--figure", "steps")


def test_densities_are_read_from_the_database(runs):
    for seed, k in enumerate((12, 16, 20)):
        add_run(runs, seed, (4, k))
    before = rows("compare", "reach", "--runs", runs)[0]["density"]
    with Store(Store.default_url(runs)) as store, store.writing() as connection:
        stored = connection.execute(select(SUCCESSES).order_by(SUCCESSES.c.reported, SUCCESSES.c.steps)).all()
        ratios = [0.6, 0.8, 1.0]
        assert [(row.steps, row.ratios) for row in stored] == [(1000, [0.2] * 3), (2000, ratios), (2000, ratios)]
        connection.execute(update(SUCCESSES).values(mean=0.125))
    assert rows("compare", "reach", "--runs", runs)[0]["density"] == before | {"mean": 0.125}


def test_experiments_are_called_by_their_labels_and_told_apart_if_they_have_one_name(runs):
    add_run(runs, 0)
    add_run(runs, 1)
    run = add_run(runs, 0, experiment=B)
    both = ("compare", A[:8], B[:8], "--runs", runs)
    assert [row["label"] for row in rows(*both)] == [f"reach {A[:8]}", run]
    assert [row["label"] for row in rows(*both, "--label", "plain", "--label", "ours")] == ["plain", "ours"]
    for labels in (("--label", "one"), ("--label", "one", "--label", "one")):
        assert "--label: 1 different labels for 2 experiments" in refused(*both, *labels)


def test_arguments_that_cannot_be_meant_are_refused(runs, tmp_path):
    there = ("--runs", runs)
    runs.mkdir()
    assert "there are no runs" in refused("compare", "reach", *there)
    run = add_run(runs, 0)
    add_run(runs, 1, experiment=B)
    add_run(runs, 0, (), name="new", experiment="c3" * 32, state="created")
    err = refused("compare", "reach", *there)
    differ = "whose specs differ, or files that they name"
    assert f"reach means 2 experiments, {differ}; name one by its hash: {A[:12]}, {B[:12]}" in err
    err = refused("compare", "reach", "new", *there, "--label", "with", "--label", "without")
    assert err.startswith("reach means 2 experiments")
    assert "means no run" in refused("compare", "nothing", *there)
    for same in ("a1a1a1a1", run):
        assert f"'a1a1a1' and {same!r} both mean {run}; name each" in refused("compare", "a1a1a1", same, *there)
    add_run(runs, 2)
    assert f"'a1a1a1' and {run!r} both mean {run}" in refused("compare", "a1a1a1", run, *there)
    assert "new has no test yet" in refused("compare", "new", *there)
    file = tmp_path / "toy.yaml"
    file.write_text("environment: toy\nagent: sac\n")
    err = refused("compare", "a1a1a1", *there, "--out", tmp_path / "x.txt")
    assert "--out: cannot write figures into 'x.txt'; name a file that ends in .html, or a folder; a" in err
    (tmp_path / "taken").touch()
    missing = tmp_path / "no"
    err = refused("compare", "a1a1a1", *there, "--out", missing / "page.html")  # before anything is compared
    assert err == f"{missing / 'page.html'}: there is no folder {missing}; make it, or name another file\n"
    code, _, err = call(app, "compare", "a1a1a1", "--runs", str(runs), "--out", str(tmp_path / "taken"))
    assert (code, str(tmp_path / "taken") in err) == (3, True)
    assert "there are no runs of" in refused("compare", file, *there)


def test_diff_shows_what_two_runs_were_made_from(runs):
    one = add_run(runs, 0)
    other = add_run(runs, 1, spec=SPEC | {"seeds": [1], "agent": {"name": "sac", "learning_rate": 1e-4}}, experiment=B)
    assert rows("diff", one, other, "--runs", runs) == [
        {"part": "run", "key": "seed", "a": 0, "b": 1, "missing": None},
        {"part": "spec", "key": "agent.learning_rate", "a": 1e-3, "b": 1e-4, "missing": None},
    ]
    code, out, _ = call(app, "diff", one, other, "--runs", str(runs))
    assert code == 0
    assert "spec: agent.learning_rate" in out
    assert call(app, "diff", one, one, "--runs", str(runs)) == (0, "", "no difference in settings, versions and code\n")


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
    found = {(row["part"], row["key"]): row["b"] for row in rows("diff", one, other, "--runs", runs)}
    assert found == {("version", "torch"): "1.0", ("code", "commit"): "abc", ("code", "x.py"): "changed: +1 -1"}


def test_diff_of_spec_files(runs, tmp_path):
    for name, steps in (("a", 100), ("b", 200)):
        (tmp_path / f"{name}.yaml").write_text(f"environment: toy\nagent: sac\ntraining: {{steps: {steps}}}\n")
    found = rows("diff", tmp_path / "a.yaml", tmp_path / "b.yaml", "--runs", runs)
    assert [(row["key"], row["a"], row["b"]) for row in found] == [("name", "a", "b"), ("training.steps", 100, 200)]
    missing = str(tmp_path / "c.yaml")
    assert f"{missing}: there is no such file" in refused("diff", missing, missing, "--runs", runs)


def test_diff_of_a_run_and_a_spec_leaves_out_what_is_not_a_runs_own(runs, tmp_path):
    file = tmp_path / "reach.yaml"
    file.write_text(
        "environment: toy\nagent: sac\nlauncher: local\nsweep: {space: {agent.learning_rate: {float: [1e-4, 1e-2]}}}\n"
        "transfer: {variants: {one: {environment.threshold: 0.1}, two: {environment.threshold: 0.2}}}\n"
    )
    run = add_run(runs, 0, spec=load_spec(file).alone().dump())
    assert [row["key"] for row in rows("diff", run, file, "--runs", runs) if row["part"] == "spec"] == []
