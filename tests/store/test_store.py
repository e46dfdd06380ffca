from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from sqlalchemy import select
from support.databases import KINDS, empty_database
from support.run_samples import SPEC, bare, indexed_run, result, stored

from karolos.errors import NoSuchRunError, StoreError, UsageError
from karolos.records import RunFolder
from karolos.records.results import TestCounts
from karolos.store import Store
from karolos.store.summaries import success_densities
from karolos.store.tables import SUCCESSES


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(Store.default_url(tmp_path), timeout=0.1)


# What it keeps.


def test_run_comes_back_as_its_folder_says(store: Store, tmp_path: Path) -> None:
    run = indexed_run(store, tmp_path, seed=2**63 - 1)
    assert store.runs() == (run.summary(),)
    for each in (result(100, 3, end=20), result(200, 19, end=20)):
        run.add_test(each)
    run.set_state("finished", steps=210, seconds=1 / 3)
    store.add_records([run.record()])
    assert store.find(run.id) == run.summary()
    found = store.find(run.id)
    assert (found.steps_to_95, found.steps_to_95_any) == (100, 200)
    assert stored(store, run.id).tests == (
        TestCounts(100, 1.0, 20, 3, 20, 0, -1.5),
        TestCounts(200, 2.0, 20, 19, 20, 0, -1.5),
    )


def test_a_state_changes_no_test_and_a_test_only_its_own_row(store: Store, tmp_path: Path) -> None:
    run = indexed_run(store, tmp_path)
    for each in (result(100, 3), result(200, 5)):
        run.add_test(each)
    store.add_records([run.record()])
    success_densities(store, "abc", "any", {100: [0.15]})
    with store.database.writing() as connection:
        for change in ("INSERT", "UPDATE", "DELETE"):
            row = "old.steps" if change == "DELETE" else "new.steps"
            rule = f"WHEN {row} < 300 BEGIN SELECT RAISE(ABORT, 'written again'); END"
            connection.exec_driver_sql(f"CREATE TRIGGER refuse_{change} BEFORE {change} ON tests {rule}")
    run.set_state("failed", steps=210)
    store.add_records([run.record()])
    assert len(store.database.fetch(select(SUCCESSES))) == 1
    run.add_test(result(300, 7))
    store.add_records([run.record()])
    assert store.database.fetch(select(SUCCESSES)) == []
    assert stored(store, run.id).tests == run.record().tests


def test_run_comes_with_its_spec_without_seeds_and_its_versions(store: Store, tmp_path: Path) -> None:
    run = indexed_run(store, tmp_path)
    record = stored(store, run.id)
    assert record.spec == {key: value for key, value in SPEC.items() if key != "seeds"}
    assert record.versions == run.record().versions != {}


def test_runs_move_with_their_database(store: Store, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    with Store(Store.default_url(runs)) as before:
        run = indexed_run(before, runs)
    moved = runs.rename(tmp_path / "elsewhere")
    with Store(Store.default_url(moved)) as after:
        assert after.runs()[0].folder == str(moved / run.id)
        assert after.runs()[0].state == "created"  # the lock is seen there, too


def test_labels_of_an_unknown_run_are_told(store: Store, tmp_path: Path) -> None:
    run = indexed_run(store, tmp_path)
    store.remove_runs([run.id])
    with pytest.raises(StoreError, match=r"is not in the database; its folder is complete"):
        store.refresh_labels(run)


# What it finds.


def test_runs_are_listed_newest_first_and_filtered(store: Store) -> None:
    old, middle, new = (
        bare(store, f"{name}-s0-1", created=f"2026-01-0{day}T00:00:00.000000Z", state=state)
        for name, day, state in (("reach", 1, "finished"), ("push", 2, "failed"), ("reach_100%", 3, "finished"))
    )
    assert store.runs() == (new, middle, old)
    assert store.runs(limit=2) == (new, middle)
    assert store.runs(state="finished") == (new, old)
    assert store.runs(state="finished", limit=1) == (new,)
    assert store.runs(prefix="reach") == (new, old)
    assert store.runs(prefix="reach_1") == (new,)
    assert store.runs(prefix="%") == ()
    assert store.runs(ids=[old.run, "none"]) == (old,)
    with pytest.raises(UsageError, match="no state 'done'; states: created, running"):
        store.runs(state="done")


def test_run_whose_process_is_gone_is_listed_as_lost(store: Store, tmp_path: Path) -> None:
    run = indexed_run(store, tmp_path)
    run.set_state("running")
    store.add_records([run.record()])
    assert [found.state for found in store.runs(state="running")] == ["running"]
    run.release()
    assert store.runs(state="running") == ()
    assert [found.state for found in store.runs(state="lost")] == ["lost"]
    assert store.find(run.id).state == "lost"


def test_end_that_was_not_indexed_any_more_is_read_from_the_folder(store: Store, tmp_path: Path) -> None:
    run = indexed_run(store, tmp_path)
    run.set_state("running")
    store.add_records([run.record()])
    run.add_test(result(100, 20))
    run.set_state("finished", steps=100)
    run.release()
    assert store.runs(state="finished") == (run.summary(),)
    assert store.runs()[0].success_any == 1.0


def test_unfinished_run_without_a_folder_stays_as_indexed(store: Store) -> None:
    bare(store, "x", state="running")
    assert store.runs()[0].state == "running"


def test_selector_means_one_run(store: Store) -> None:
    with pytest.raises(UsageError, match="there are no runs yet"):
        store.find("@last")
    first = bare(store, "reach-s0-1", created="2026-01-01")
    second = bare(store, "reach-s0-1-2", created="2026-01-02")
    other = bare(store, "push-s0-1", created="2026-01-03", folder="/nowhere/push-s0-1")
    assert store.find("reach-s0-1") == first  # an id, though it begins another
    assert store.find("reach-s0-1-") == second
    assert store.find("pu") == other
    assert store.find("@last") == other
    assert store.find("/nowhere/push-s0-1/") == other
    with pytest.raises(UsageError, match="means several runs; one of reach-s0-1-2, reach-s0-1; or @last"):
        store.find("reach")
    for nothing in ("pull", "", "..", "/", "%", "PUSH", "runs/push-s0-1", "/nowhere/pu"):
        with pytest.raises(UsageError, match=r"means no run; `karolos runs list`"):
            store.find(nothing)
    for index in range(6):
        bare(store, f"y{index}")
    with pytest.raises(UsageError, match=r"several runs; one of (y\d, ){4}y\d \.\.\.; or @last"):
        store.find("y")


def test_path_of_a_run_folder_means_no_other_run(store: Store, tmp_path: Path) -> None:
    run = indexed_run(store, tmp_path)
    copy = shutil.copytree(run.path, tmp_path / "elsewhere" / run.id)
    (tmp_path / "link").symlink_to(run.path)
    for path in (run.path, tmp_path / "link"):
        assert store.select(str(path)) == (run.summary(),)
    with pytest.raises(NoSuchRunError, match=r"the run folder .* is not in the index; name its runs folder"):
        store.select(str(copy))
    with pytest.raises(NoSuchRunError, match="means no run"):
        store.select(str(tmp_path / "elsewhere" / "reach"))


# Many at once.

MANY = """
import os, sys
from dataclasses import replace
from pathlib import Path
from karolos.records import labels
from karolos.store import Store
from karolos.records import RunFolder
from karolos.records.results import TestResult

runs, url, start = Path(sys.argv[1]), sys.argv[2], os.pipe()
children = []
for index in range(20):
    child = os.fork()
    if not child:
        os.close(start[1])
        os.read(start[0], 1)  # all begin at once
        run = RunFolder.create(runs, "x", index)
        run.describe({"name": "x"}, experiment="same", source=runs)
        with Store(url) as store:
            store.add_records([run.record()])
            for steps in range(5):
                run.add_test(TestResult(steps, 1.0, (True,), (True,), (False,), (0.0,), (1,)))
                run.set_state("running", steps=steps)
                store.add_records([run.record()])
            run.set_state("finished", steps=5)
            store.add_records([run.record()])
            shared = RunFolder.open(runs / "shared")
            store.add_records([shared.record()])  # by each: none may bring back what it read before others wrote
            labels.add_tags(shared.path, [f"tag{index}"])
            store.refresh_labels(shared)
        os._exit(0)
    children.append(child)
os.close(start[1])
sys.exit(any(os.waitpid(child, 0)[1] for child in children))
"""


@pytest.mark.parametrize("kind", KINDS)
def test_twenty_processes_make_the_database_at_once_and_lose_nothing(tmp_path: Path, kind: str) -> None:
    with empty_database(kind, tmp_path) as url:
        with RunFolder.create(tmp_path, "x", 99) as shared:
            shared.describe({"name": "x"}, experiment="same", source=tmp_path)
        shared.path.rename(tmp_path / "shared")
        subprocess.run([sys.executable, "-c", MANY, str(tmp_path), url], check=True, timeout=60)
        with Store(url) as store:
            (labelled,) = store.runs(ids=[shared.id])
            assert set(labelled.tags) == {f"tag{index}" for index in range(20)}
            runs = store.runs(where="not seed = 99")
            assert {(run.seed, run.state, run.steps) for run in runs} == {(seed, "finished", 5) for seed in range(20)}
            assert all(len(record.tests) == 5 for record in store.records(runs))


def test_sqlite_on_a_network_share_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("karolos.system.network_share", lambda path: "nfs4")
    with pytest.raises(StoreError, match=r"SQLite loses data on a network share \(nfs4\)"):
        Store(Store.default_url(tmp_path))
