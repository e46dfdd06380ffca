import re
import shutil
import sqlite3
import tarfile
from contextlib import closing
from pathlib import Path

from support.commands import karolos, refused, rows
from support.run_samples import add_run

from karolos.launchers.experiment import resume_run
from karolos.records import RunFolder
from karolos.store import Store


def test_reindex_rebuilds_what_was_removed_and_names_what_is_damaged(runs):
    first, second = add_run(runs, 0), add_run(runs, 1)
    before = rows("runs", "list")
    (runs / "karolos.sqlite").unlink()
    assert "2 runs entered, 0 forgotten" in karolos("db", "reindex").err
    assert rows("runs", "list") == before
    with (runs / first / "tests.jsonl").open("a") as file:
        file.write('{"steps":')
    (runs / second / "run.json").write_text("{")
    told = karolos("db", "reindex", code=1).err
    assert f"warning: {first}: tests.jsonl:2: the last line is torn; left out" in told
    assert "run.json is damaged" in told
    assert "1 run entered, 0 forgotten" in told
    assert len(rows("runs", "list")) == 2  # damaged is not gone


def test_check_is_silent_or_lists_differences_and_ends_with_4(runs):
    first, second = add_run(runs, 0), add_run(runs, 1)
    assert karolos("db", "check", "--json") == (0, "", "the database agrees with the run folders\n")
    with Store(Store.default_url(runs)) as store:
        store.remove_runs([first])
    shutil.rmtree(runs / second)
    told = karolos("db", "check", code=4)
    assert f"{first}" in told.out
    assert "it has a folder, and is not in the database" in told.out
    assert "it is in the database, and its folder is gone" in told.out
    assert "2 differences; `karolos db reindex` corrects the database, but changes no folder" in told.err
    karolos("db", "reindex")
    assert karolos("db", "check").out == ""


def test_where_there_is_nothing_this_is_told_and_nothing_is_made(runs):
    for command in ("check", "upgrade", "reindex"):  # with a database elsewhere, too: its runs would be lost
        told = refused("db", command, "--database", f"sqlite:///{runs.parent}/other.sqlite")
        assert "there is no folder" in told
    assert not runs.exists()
    runs.mkdir()
    for command in ("check", "upgrade"):
        assert "there is no database; `karolos db reindex` makes one" in refused("db", command, code=4)
    assert [*runs.parent.rglob("*.sqlite")] == []


def changed(runs: Path, script: str) -> None:
    """Change the database with SQL."""
    with closing(sqlite3.connect(runs / "karolos.sqlite")) as database:
        database.executescript(script)


def test_upgrade_has_nothing_to_do_for_this_schema_and_refuses_a_newer_one(runs):
    add_run(runs, 0)
    listed = rows("runs", "list")
    changed(  # as of 0.2, which had tables of sweeps
        runs,
        "UPDATE karolos_schema SET version = 10; ALTER TABLE runs DROP COLUMN 'commit';"
        "CREATE TABLE sweeps (sweep TEXT PRIMARY KEY); CREATE TABLE trials (sweep TEXT REFERENCES sweeps(sweep));",
    )
    assert "1 run entered, 0 forgotten" in karolos("db", "upgrade").err
    assert rows("runs", "list") == listed
    assert "nothing to do" in karolos("db", "upgrade").err
    changed(runs, "UPDATE karolos_schema SET version = version + 1")
    told = refused("db", "upgrade", code=4)
    assert re.search(r"a newer karolos made .*; move it away and run `karolos db reindex`", told)


def test_runs_and_database_of_version_0_1_are_listed_shown_compared_and_continued(runs):
    """Written by karolos 0.1: two finished runs, one that was stopped, and the database with schema 7."""
    with tarfile.open(Path(__file__).with_name("runs_of_0.1.tar.xz")) as archive:
        archive.extractall(runs.parent, filter="data")
    with closing(sqlite3.connect(runs / "karolos.sqlite")) as old:
        before = old.execute("SELECT run, state, steps, success_end, mean_return FROM runs ORDER BY run").fetchall()
    changed(runs, "UPDATE runs SET run = 'gone' WHERE run LIKE 'toy%'")
    told = refused("runs", "list", code=4)
    assert re.search(r"an older karolos made .*; `karolos db upgrade` renews it", told)
    told = karolos("db", "upgrade").err
    assert "3 runs entered, 0 forgotten" in told
    assert f"warning: gone: its folder is not in {runs}" in told
    assert "the database agrees" in karolos("db", "check").err
    with closing(sqlite3.connect(runs / "karolos.sqlite")) as new:
        assert new.execute("SELECT DISTINCT typeof(seed) FROM runs WHERE seed < 3").fetchall() == [("integer",)]
    listed = sorted(rows("runs", "list"), key=lambda row: row["run"])
    keys = ("run", "state", "steps", "success_end", "mean_return")
    assert [tuple(row[key] for key in keys) for row in listed] == before
    (shown,) = rows("runs", "show", listed[0]["run"])
    assert [(test["steps"], test["episodes"]) for test in shown["tests"]] == [(100, 20), (200, 20)]
    reach, toy = rows("compare", "reach_by_01", "toy_by_01")
    assert (reach["n"], reach["seeds"], reach["final"], toy["success_end"]["value"]) == (2, [0, 1], True, 1.0)
    stopped = RunFolder.open(runs / listed[2]["run"])
    outcome = resume_run(stopped, Store.default_url(runs))
    assert [(run.state, run.steps, run.attempt) for run in outcome.runs] == [("finished", 2000, 2)]
    told, resumed = (event for event in stopped.events() if event["event"] in ("warning", "resumed"))
    assert re.search(r"began with other software: karolos is .* here and 0\.1\.0 there", str(told))
    assert not resumed["bit_exact"]
