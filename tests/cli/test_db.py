import re
import shutil
import sqlite3
import tarfile
from pathlib import Path

import pytest
import typer
from karolos_cli.compare import compare
from karolos_cli.db import app
from karolos_cli.runs import app as runs_app
from support.run_commands import call, rows
from support.run_samples import add_run

from karolos.errors import StoreError, UsageError
from karolos.launchers.experiment import resume_run
from karolos.records import RunFolder
from karolos.store import Store

compare_app = typer.Typer()
compare_app.command()(compare)


def test_reindex_rebuilds_what_was_removed_and_names_what_is_damaged(runs):
    first, second = add_run(runs, 0), add_run(runs, 1)
    before = rows(runs_app, "list")
    (runs / "karolos.sqlite").unlink()
    assert "2 runs entered, 0 forgotten" in call(app, "reindex").stderr
    assert rows(runs_app, "list") == before
    with (runs / first / "tests.jsonl").open("a") as file:
        file.write('{"steps":')
    (runs / second / "run.json").write_text("{")
    told = call(app, "reindex", exit_code=1).stderr
    assert f"warning: {first}: tests.jsonl:2: the last line is torn; left out" in told
    assert "run.json is damaged" in told
    assert "1 runs entered, 0 forgotten" in told
    assert len(rows(runs_app, "list")) == 2  # damaged is not gone


def test_check_is_silent_or_lists_differences_and_ends_with_4(runs):
    first, second = add_run(runs, 0), add_run(runs, 1)
    fine = call(app, "check", "--json")
    assert (fine.stdout, fine.stderr) == ("", "the database agrees with the run folders\n")
    with Store(Store.default_url(runs)) as store:
        store.remove_runs([first])
    shutil.rmtree(runs / second)
    told = call(app, "check", exit_code=4)
    assert f"{first}" in told.stdout
    assert "it has a folder, and is not in the database" in told.stdout
    assert "it is in the database, and its folder is gone" in told.stdout
    assert "2 differences; `karolos db reindex`" in told.stderr
    call(app, "reindex")
    assert call(app, "check").stdout == ""


def test_check_of_nothing_is_told_and_makes_nothing(runs):
    with pytest.raises(StoreError, match="there is no database; `karolos db reindex` makes one"):
        call(app, "check")
    with pytest.raises(UsageError, match="there is no folder"):
        call(app, "reindex")
    assert not runs.exists()


def test_upgrade_has_nothing_to_do_for_this_schema_and_refuses_a_newer_one(runs):
    with pytest.raises(StoreError, match="there is no database; `karolos db reindex` makes one"):
        call(app, "upgrade")
    add_run(runs, 0)
    listed = rows(runs_app, "list")
    with sqlite3.connect(runs / "karolos.sqlite") as old:  # as of 0.2, which had tables of sweeps
        old.executescript(
            "UPDATE karolos_schema SET version = 10; ALTER TABLE runs DROP COLUMN 'commit';"
            "CREATE TABLE sweeps (sweep TEXT PRIMARY KEY); CREATE TABLE trials (sweep TEXT REFERENCES sweeps(sweep));"
        )
    old.close()
    assert "1 runs entered, 0 forgotten" in call(app, "upgrade").stderr
    assert rows(runs_app, "list") == listed
    assert "nothing to do" in call(app, "upgrade").stderr
    with sqlite3.connect(runs / "karolos.sqlite") as other:
        other.execute("UPDATE karolos_schema SET version = version + 1")
    other.close()
    with pytest.raises(StoreError, match=r"a newer karolos made .*; move it away and run `karolos db reindex`"):
        call(app, "upgrade")


def test_runs_and_database_of_version_0_1_are_listed_shown_compared_and_continued(runs):
    """Written by karolos 0.1: two finished runs, one that was stopped, and the database with schema 7."""
    with tarfile.open(Path(__file__).with_name("runs_of_0.1.tar.xz")) as archive:
        archive.extractall(runs.parent, filter="data")
    with sqlite3.connect(runs / "karolos.sqlite") as old:
        before = old.execute("SELECT run, state, steps, success_end, mean_return FROM runs ORDER BY run").fetchall()
        old.execute("UPDATE runs SET run = 'gone' WHERE run LIKE 'toy%'")
    old.close()
    with pytest.raises(StoreError, match=r"an older karolos made .*; `karolos db upgrade` renews it"):
        call(runs_app, "list")
    told = call(app, "upgrade").stderr
    assert "3 runs entered, 0 forgotten" in told
    assert f"warning: gone: its folder is not in {runs}" in told
    assert "the database agrees" in call(app, "check").stderr
    with sqlite3.connect(runs / "karolos.sqlite") as new:
        assert new.execute("SELECT DISTINCT typeof(seed) FROM runs WHERE seed < 3").fetchall() == [("integer",)]
    new.close()
    listed = sorted(rows(runs_app, "list"), key=lambda row: row["run"])
    assert [
        tuple(row[key] for key in ("run", "state", "steps", "success_end", "mean_return")) for row in listed
    ] == before
    (shown,) = rows(runs_app, "show", listed[0]["run"])
    assert [(test["steps"], test["episodes"]) for test in shown["tests"]] == [(100, 20), (200, 20)]
    reach, toy = rows(compare_app, "reach_by_01", "toy_by_01")
    assert (reach["n"], reach["seeds"], reach["final"], toy["success_end"]["value"]) == (2, [0, 1], True, 1.0)
    stopped = RunFolder.open(runs / listed[2]["run"])
    outcome = resume_run(stopped, Store.default_url(runs))
    assert [(run.state, run.steps, run.attempt) for run in outcome.runs] == [("finished", 2000, 2)]
    told, resumed = (event for event in stopped.events() if event["event"] in ("warning", "resumed"))
    assert re.search(r"began with other software: karolos is .* here and 0\.1\.0 there", str(told))
    assert not resumed["bit_exact"]
