"""`karolos runs`: lists, one run, filters, CSV, labels, trash, archives."""

import csv
import io
import shutil
import sqlite3
import sys
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import typer
from karolos_cli.run import report
from support import commands, run_samples
from support.run_samples import stored

from karolos.launchers.experiment import Outcome
from karolos.records import RunFolder, checkpoint
from karolos.specification import load_spec
from karolos.store import Store

SPEC = {"name": "reach", "environment": {"name": "toy"}, "robot": None, "agent": {"name": "sac"}, "seeds": [0, 1]}
karolos, rows, refused = (partial(made, "runs") for made in (commands.karolos, commands.rows, commands.refused))


def add_run(runs: Path, seed: int, state: str = "finished", spec: dict[str, Any] | None = None) -> str:
    """A run with a test, which measures a force, and a checkpoint."""
    force = {"unit": "N", "better": "smaller", "values": (None, *[10.0 * seed + 4] * 19)}
    about = {"spec": spec or SPEC, "experiment": "abc", "text": "environment: toy\n"}
    error = "it broke" if state == "failed" else None
    run = run_samples.add_run(runs, seed, state=state, error=error, measures={"peak_force": force}, **about)
    checkpoint.save(runs / run / "checkpoints", "best", {"agent": {}}, {"steps": 1000})
    return run


def ids(*arguments: object) -> list[str]:
    return [row["run"] for row in rows("list", *arguments)]


@pytest.fixture
def two(runs):
    """A finished and a failed run."""
    return add_run(runs, 0), add_run(runs, 1, "failed")


@pytest.fixture
def alike(runs):
    """Two finished runs of an experiment."""
    return run_samples.add_run(runs, 0), run_samples.add_run(runs, 1)


def test_list_gives_a_row_per_run_newest_first(two):
    first, second = two
    found = rows("list")
    assert [row["run"] for row in found] == [second, first]
    keys = "run experiment seed state steps seconds success_any success_end steps_to_95 seconds_to_95"
    assert list(found[0])[:10] == keys.split()
    assert found[1].items() >= {"seed": 0, "state": "finished", "success_any": 0.95, "steps_to_95": 1000}.items()
    table = karolos("list").out
    assert first in table
    assert "0.95 [0.76, 0.99]" in table
    assert all(line == line.rstrip() for line in table.splitlines())


def test_list_sorts_and_groups(two):
    first, second = two
    for sort, expected in (("seed", [first, second]), ("-seed", [second, first]), ("state", [second, first])):
        assert ids("--sort", sort) == expected
    assert [row["agent.name"] for row in rows("list", "--columns", "agent.name", "--sort", "seed")]
    [group] = rows("list", "--group", "--sort", "-success_end")
    assert (group["name"], group["runs"], group["states"]) == ("reach", 2, "1 failed, 1 finished")
    assert (group["success_end"], group["best_end"]) == (0.95, None)


def test_a_group_has_one_run_per_seed_and_counts_those_that_never_reach_95(runs):
    add_run(runs, 0)
    for seed, successes in ((0, ()), (2, (19,)), *((seed, (0,)) for seed in (3, 4, 5))):
        run_samples.add_run(runs, seed, successes, spec=SPEC, experiment="abc")
    [group] = rows("list", "--group")
    assert (group["runs"], group["steps"]) == (6, 800)  # the newer run of seed 0, which has no test
    assert "reach: 1 of 6 runs repeat a seed" in karolos("list", "--group").err
    for chosen, median, reached in (
        ("seed<9", None, "1 of 4"),
        ("seed in (2, 3)", None, "1 of 2"),
        ("seed=2", 1000, "1 of 1"),
        ("seed=0", None, None),
    ):
        [group] = rows("list", chosen, "--group")
        assert (group["steps_to_95"], group["reached_95"]) == (median, reached)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--watch", "--json"], "--watch takes no --json"),
        (["--watch", "--trash"], "--watch takes no --trash"),
        (["--trash", "--json", "--columns", "run"], "--trash takes no --columns"),
        (["--group", "--columns", "run"], "--group cannot be combined with --columns"),
        (["--csv", "--json"], "--csv cannot be combined with --json"),
        (["--sort", "sed"], "no run has a column 'sed'"),
        (["--group", "--sort", "seed"], "there is no column 'seed' with --group"),
        (["--state", "done"], "there is no state 'done'"),
        (["measures.peak < 24"], "no run has 'measures.peak'; did you mean measures.peak_force"),
    ],
)
def test_what_a_list_does_not_know_or_would_ignore_is_refused(two, options, told):
    assert told in refused("list", *options)


def test_list_filters_and_limits(runs, two):
    first, failed = two
    lost = add_run(runs, 2, "running")
    for options, found in (
        (["--state", "failed"], [failed]),
        (["--state", "lost"], [lost]),
        (["--limit", 1], [lost]),
        (["measures.peak_force < 24"], [failed, first]),
    ):
        assert ids(*options) == found
    columns = ("--columns", "seed,measures.peak_force", "--sort", "-measures.peak_force")
    assert [row["measures.peak_force"] for row in rows("list", *columns)] == [24, 14, 4]
    for chosen, told in (("--state=stopped", "no runs are stopped\n"), ("task=push", "no runs match the filter\n")):
        assert karolos("list", chosen) == (0, "", told)


def test_environment_names_folder_and_database(runs, monkeypatch):
    run = add_run(runs, 0)
    monkeypatch.setenv("KAROLOS_RUNS", str(runs.parent))
    assert ids("--runs", runs) == [run]
    monkeypatch.setenv("KAROLOS_DATABASE", Store.default_url(runs))
    assert ids() == [run]


@pytest.mark.usefixtures("runs")
def test_place_without_runs_lists_nothing_and_makes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("KAROLOS_RUNS")
    assert karolos("list") == (0, "", "no runs in runs yet; `karolos run SPEC` makes one\n")
    assert rows("list") == []
    assert "means no run: there are no runs in runs yet" in refused("show", "@last")
    assert list(tmp_path.iterdir()) == []
    assert "there is no folder elsewhere; name the runs folder" in refused("list", "--runs", "elsewhere")
    (tmp_path / "runs").touch()
    assert "runs is not a folder; name the runs folder" in refused("list", "--runs", "runs")


@pytest.mark.parametrize("emptied", [Path.unlink, Path.write_bytes])
def test_missing_or_empty_index_is_rebuilt_from_the_folders(runs, emptied):
    add_run(runs, 0)
    before = rows("list")
    emptied(runs / "karolos.sqlite", *[b""] * (emptied is Path.write_bytes))
    assert "rebuilt from 1 run folders" in karolos("list").err
    assert rows("list") == before


def test_show_tells_all_about_a_run(runs):
    run = add_run(runs, 0, "failed")
    (found,) = rows("show", "@last")
    assert found["run"] == run
    assert found["spec"] == SPEC
    interval = [pytest.approx(0.7639, abs=1e-4), pytest.approx(0.9911, abs=1e-4)]
    counts = {"steps": 1000, "seconds": 10.0, "episodes": 20, "mean_return": -1.5, "solved_at_reset": 0}
    for way in ("success_any", "success_end"):
        counts |= {way: 0.95, f"{way}_interval": interval}
    measures = {"peak_force": {"unit": "N", "better": "smaller", "mean": 4.0}}
    assert found["tests"] == [counts | {"measures": measures}]
    assert found["checkpoints"] == [{"name": "best", "steps": 1000}]
    assert found["versions"]["python"] == sys.version.split()[0]
    assert found["problems"] == []
    short, text = (karolos("show", run[:9], *options).out for options in ((), ("--all",)))
    for part in (run, "failed: it broke", "0.95 [0.76, 0.99]", str(runs)):
        assert part in short
        assert part in text
    for part in ("best (1,000 steps)", "agent.name", "numpy"):
        assert part in text
    assert not [part for part in ("best (1,000 steps)", "numpy") if part in short]


def test_show_names_what_is_damaged(runs):
    run = add_run(runs, 0)
    with (runs / run / "tests.jsonl").open("a") as file:
        file.write('{"steps":')
    (runs / run / "checkpoints" / "best" / "manifest.json").write_text("{}")
    told = karolos("show", run).err
    assert "warning: tests.jsonl:2: the last line is torn" in told
    assert "the checkpoint is damaged" in told
    (runs / run / "run.json").unlink()
    assert "not a run folder" in refused("show", run, code=1)


def test_show_without_a_folder_tells_what_the_index_knows(runs):
    run = add_run(runs, 0)
    shutil.rmtree(runs / run)
    (found,) = rows("show", run)
    assert found["spec"] == {key: value for key, value in SPEC.items() if key != "seeds"}
    assert len(found["tests"]) == 1
    assert found["problems"] == [f"the run folder is missing: {runs / run}"]


def test_show_knows_the_runs_that_ship_unless_one_of_ones_own_has_the_name(runs):
    (shipped,) = rows("show", "panda_pick", "--runs", runs.parent)
    assert (shipped["name"], shipped["state"]) == ("panda_pick", "finished")
    run = run_samples.add_run(runs, 0, name="panda_pick")
    assert rows("show", "panda_pick")[0]["run"] == run
    assert "did you mean 'panda_pick'" in refused("show", "panda_pikc")


def test_watch_shows_what_runs_where_until_nothing_runs(runs, monkeypatch):
    folder = RunFolder.create(runs, "reach", 7)
    folder.describe({}, experiment="e")
    folder.set_state("running", steps=100)
    folder.launch.write_text('{"host": "node-3"}')
    folder.progress.write_text('{"RunAdvanced": {"steps": 1234}}')

    def end(seconds: float) -> None:
        folder.set_state("finished")
        folder.release()

    monkeypatch.setattr("karolos_cli.runs.time.sleep", end)
    shown = karolos("list", "--watch")
    assert shown.out.splitlines()[1].split() == [folder.id, "running", "node-3", "1,234"]
    assert "nothing runs" in shown.err


def test_only_what_runs_can_be_stopped(runs):
    assert "is finished: there is nothing to stop" in refused("stop", run_samples.add_run(runs, 0))


def test_a_command_says_how_to_continue_a_lost_run(runs, capsys):
    run = add_run(runs, 0, "running")
    with pytest.raises(typer.Exit):
        report(Outcome.of([RunFolder.open(runs / run).summary()], 1), runs, quiet=False, json=False)
    assert f"{run} is lost: `karolos resume {run}" in capsys.readouterr().err


def test_csv_has_all_columns_and_no_formulas(runs):
    first = run_samples.add_run(runs, 0)
    karolos("tag", "--", first, "=1+1", "-x")
    karolos("note", first, '=HYPERLINK("http://x"), "quoted"\nsecond line \x1b[2J')
    (row,) = csv.DictReader(io.StringIO(karolos("list", "--csv").out))
    assert list(row)[:4] == ["run", "experiment", "seed", "state"]
    assert row["run"] == first
    assert row["tags"] == "'-x; =1+1"
    assert row["note"] == '\'=HYPERLINK("http://x"), "quoted"\nsecond line \N{REPLACEMENT CHARACTER}[2J'
    assert row["success_any"] == "0.95"


def test_tags_and_notes_are_found_shown_and_taken_away(runs, alike):
    first, _ = alike
    karolos("tag", first, "good", "<script>alert(1)</script>")
    karolos("note", first, "fell \x1b[2Jover")
    assert ids("tags=good") == ids("note~over") == [first]
    for shown in (karolos("list").out, karolos("show", first).out):
        assert "<script>alert(1)</script>, good" in shown
        assert "\x1b[2J" not in shown
    assert rows("tag", "reach", "all")[0]["tags"] == ["all"]  # the experiment's name: both runs
    assert sorted(ids("tags=all")) == sorted(alike)
    assert karolos("tag", "reach", "good", "--remove").err == "1 run changed\n"
    karolos("note", first, "--remove")
    for command, same in (
        (["tag", "reach", "good", "--remove"], "no run has such a tag"),
        (["tag", "reach", "all"], "all have these tags already"),
        (["note", first, "--remove"], "no run has a note"),
    ):
        assert karolos(*command).err == f"nothing changed: {same}\n"
    assert ids("tags=good") == ids("note!=null") == []
    assert RunFolder.open(runs / first).labels().tags == ("<script>alert(1)</script>", "all")
    for wrong in (["note", first], ["note", first, "text", "--remove"], ["note", first, ""]):
        assert "a note needs a text" in refused(*wrong)
    assert "is not a tag" in refused("tag", first, "two\nlines")


def test_removed_runs_come_back_with_all_they_had(alike):
    first, second = alike
    karolos("tag", first, "good")
    before = rows("list")
    assert first in karolos("rm", first).out
    assert ids() == [second]
    assert ids("--trash") == [first]
    assert karolos("list", "--trash").out == f"{first}\n"
    karolos("restore", first[:8])
    assert rows("list") == before
    assert karolos("list", "--trash").out == ""


def test_what_a_database_refuses_is_told_with_what_has_happened_to_the_folder(runs, alike):
    first, second = alike
    karolos("list")
    with closing(sqlite3.connect(runs / "karolos.sqlite")) as index:
        for change in ("UPDATE", "DELETE", "INSERT"):
            index.execute(f"CREATE TRIGGER no_{change} BEFORE {change} ON runs BEGIN SELECT RAISE(ABORT, 'no'); END")
    enters = "and `karolos db reindex` enters this"
    assert f"the folder of {first} has its new tags and note, {enters}" in karolos("tag", first, "good", code=4).err
    removed = karolos("rm", second, code=4)
    assert f"{second} is in the trash, {enters}" in removed.err
    assert removed.out.startswith(f"{second} -> ")
    assert f"{second} is out of the trash, {enters}" in karolos("restore", second, code=4).err


def test_filter_chooses_what_is_removed(runs):
    first, second = run_samples.add_run(runs, 0), run_samples.add_run(runs, 1, rate=1e-4)
    for words, told in (
        ([], "which runs"),
        ([first, "--where", "seed=1"], "no runs match the filter"),
        (["reach-"], "'reach-' means several runs"),
        ([second, "--purge"], "--purge empties the trash and takes no RUN"),
    ):
        assert told in refused("rm", *words)
    with RunFolder.open(runs / first) as running:
        running.lock()
        assert karolos("rm", second, first, code=1).out.startswith(f"{second} -> "), "what was moved before is told"
    karolos("restore", second)
    karolos("rm", "--where", "agent.learning_rate<1e-3")
    assert ids() == [first]
    karolos("rm", "reach")
    assert ids() == []
    assert len(ids("--trash")) == 2
    assert "2 runs removed for good" in karolos("rm", "--purge").err
    assert ids("--trash") == []


def test_path_of_a_run_folder_elsewhere_changes_no_run_of_the_index(runs, tmp_path):
    run_samples.add_run(runs, 0)
    other = tmp_path / "other"
    copy = shutil.copytree(other / run_samples.add_run(other, 0), other / "reach-s0")
    before = rows("list")
    for command in (("rm", copy), ("tag", copy, "good"), ("note", copy, "text")):
        assert "reach-s0 is not in the index; name its runs folder with --runs" in refused(*command)
    assert rows("list") == before


def test_exported_runs_come_in_elsewhere(alike, tmp_path):
    karolos("tag", alike[0], "good")
    file, other = tmp_path / "x.tar.gz", tmp_path / "other"
    karolos("export", file, "reach")
    assert set(karolos("import", file, "--runs", other).out.split()) == set(alike)
    came = rows("list", "--runs", other)
    assert [{**row, "folder": ""} for row in came] == [{**row, "folder": ""} for row in rows("list")]
    with Store(Store.default_url(other)) as store:
        assert len(stored(store, alike[0]).tests) == 1
    assert "exists already; `karolos runs rm`" in refused("import", file, "--runs", other)
    assert rows("list", "--runs", other) == came
    told = refused("import", file, "--runs", file, code=3)
    assert (file.name in told, told.count("\n")) == (True, 1)


def test_spec_file_means_the_runs_of_its_experiment(runs, tmp_path):
    path = tmp_path / "toy.yaml"
    path.write_text("environment: toy\nagent: sac\n")
    run_samples.add_run(runs, 0)
    told = refused("show", path)
    assert ("there are no runs of" in told, "toy.yaml; `karolos run" in told) == (True, True)
    spec = load_spec(path)
    run = run_samples.add_run(runs, 0, (), name="toy", spec=spec.dump(), experiment=spec.hash(), state="created")
    assert rows("show", path)[0]["run"] == run
    assert [row["run"] for row in rows("tag", path, "mine")] == [run]
