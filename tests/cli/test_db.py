from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path

import pytest
from karolos_cli.db import app
from karolos_cli.runs import app as runs_app
from support.run_commands import add_run, call, rows

from karolos.errors import StoreError
from karolos.store import Store


def test_reindex_rebuilds_what_was_removed_and_names_what_is_damaged(runs: Path) -> None:
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


def test_check_is_silent_or_lists_differences_and_ends_with_4(runs: Path) -> None:
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


def test_check_of_nothing_is_told_and_makes_nothing(runs: Path) -> None:
    with pytest.raises(StoreError, match="there is no database; `karolos db reindex` makes one"):
        call(app, "check")
    assert not runs.exists()


def test_upgrade_has_nothing_to_do_for_this_schema_and_refuses_others(runs: Path) -> None:
    with pytest.raises(StoreError, match="there is no database; `karolos db reindex` makes one"):
        call(app, "upgrade")
    run = add_run(runs, 0)
    assert "nothing to do" in call(app, "upgrade").stderr
    with sqlite3.connect(runs / "karolos.sqlite") as other:
        other.execute("UPDATE karolos_schema SET version = version - 1")
    other.close()
    for command, arguments in ((app, ["upgrade"]), (app, ["reindex"]), (runs_app, ["list"])):
        with pytest.raises(StoreError, match=r"an older karolos made .*; move it away and run `karolos db reindex`"):
            call(command, *arguments)
    (runs / "karolos.sqlite").rename(runs / "old.sqlite")
    call(app, "reindex")
    assert [found["run"] for found in rows(runs_app, "list")] == [run]
