"""What the index keeps, what it finds, how it is asked, and what it refuses."""

import json
import os
import resource
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import event, make_url, select, update
from sqlalchemy.exc import OperationalError, ProgrammingError
from support.databases import KINDS, empty_database
from support.fork_server import FORKS
from support.run_samples import bare, indexed_run, new_run, result, stored

from karolos.errors import MachineError, NoSuchRunError, StoreError, UsageError
from karolos.records import RunFolder, labels
from karolos.records.evaluation import Evaluation
from karolos.records.run_records import RunSummary
from karolos.store import Store, query
from karolos.store.database import explained
from karolos.store.density import kde
from karolos.store.experiments import success_densities
from karolos.store.tables import SCHEMA, SUCCESSES


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(Store.default_url(tmp_path), timeout=0.1)


# What it keeps.


def test_run_comes_back_as_its_folder_says(store, tmp_path):
    run = indexed_run(store, tmp_path, seed=2**63 - 1)
    assert store.runs() == (run.summary(),)
    for each in (result(100, 3, end=20), result(200, 19, end=20)):
        run.add_test(each)
    run.set_state("finished", steps=210, seconds=1 / 3)
    store.add_records([run.record()])
    assert query.find(store, run.id) == run.summary()
    found = query.find(store, run.id)
    assert (found.steps_to_95, found.steps_to_95_any) == (100, 200)
    assert stored(store, run.id).tests == (
        Evaluation(100, 1.0, 20, 3, 20, 0, -1.5),
        Evaluation(200, 2.0, 20, 19, 20, 0, -1.5),
    )


def test_a_state_changes_no_test_and_a_test_only_its_own_row(store, tmp_path):
    run = indexed_run(store, tmp_path)
    for each in (result(100, 3), result(200, 5)):
        run.add_test(each)
    store.add_records([run.record()])
    success_densities(store, "abc", "any", {100: [0.15]})
    with store.writing() as connection:
        for change in ("INSERT", "UPDATE", "DELETE"):
            row = "old.steps" if change == "DELETE" else "new.steps"
            rule = f"WHEN {row} < 300 BEGIN SELECT RAISE(ABORT, 'written again'); END"
            connection.exec_driver_sql(f"CREATE TRIGGER refuse_{change} BEFORE {change} ON tests {rule}")
    run.set_state("failed", steps=210)
    store.add_records([run.record()])
    assert len(store.fetch(select(SUCCESSES))) == 1
    run.add_test(result(300, 7))
    store.add_records([run.record()])
    assert store.fetch(select(SUCCESSES)) == []
    assert stored(store, run.id).tests == run.record().tests


def test_runs_move_with_their_database(store, tmp_path):
    runs = tmp_path / "runs"
    with Store(Store.default_url(runs)) as before:
        run = indexed_run(before, runs)
    moved = runs.rename(tmp_path / "elsewhere")
    with Store(Store.default_url(moved)) as after:
        assert after.runs()[0].folder == str(moved / run.id)
        assert after.runs()[0].state == "created"  # the lock is seen there, too


def test_labels_of_an_unknown_run_are_told(store, tmp_path):
    run = indexed_run(store, tmp_path)
    store.remove_runs([run.id])
    with pytest.raises(StoreError, match=r"is not in the database; the folder of .* has its new tags"):
        store.refresh_labels(run)


# What it finds.


def test_runs_are_listed_newest_first_and_filtered(store):
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


def test_run_whose_process_is_gone_is_listed_as_lost_if_its_folder_is_there(store, tmp_path):
    run = indexed_run(store, tmp_path)
    run.set_state("running")
    store.add_records([run.record()])
    assert [found.state for found in store.runs(state="running")] == ["running"]
    run.release()
    assert store.runs(state="running") == ()
    assert [found.state for found in store.runs(state="lost")] == ["lost"]
    assert query.find(store, run.id).state == "lost"
    run.path.rename(tmp_path / "elsewhere")
    assert store.runs()[0].state == "running"


def test_end_that_was_not_indexed_any_more_is_read_from_the_folder(store, tmp_path):
    run = indexed_run(store, tmp_path)
    run.set_state("running")
    store.add_records([run.record()])
    run.add_test(result(100, 20))
    run.set_state("finished", steps=100)
    run.release()
    assert store.runs(state="finished") == (run.summary(),)
    assert store.runs()[0].success_any == 1.0


def test_selector_means_one_run(store):
    with pytest.raises(UsageError, match="there are no runs yet"):
        query.find(store, "@last")
    first = bare(store, "reach-s0-1", created="2026-01-01")
    second = bare(store, "reach-s0-1-2", created="2026-01-02")
    other = bare(store, "push-s0-1", created="2026-01-03", folder="/nowhere/push-s0-1")
    meant = {
        "reach-s0-1": first,  # an id, though it begins another
        **dict.fromkeys(("reach-s0-1-", "@last-1"), second),
        **dict.fromkeys(("pu", "@last", "/nowhere/push-s0-1/"), other),
    }
    assert {selector: query.find(store, selector) for selector in meant} == meant
    for index in range(6):
        bare(store, f"y{index}", experiment=f"abcdef{index % 2}" + "1" * 57, created="2025")
    refused = {
        "reach": "means several runs; one of reach-s0-1-2, reach-s0-1; or @last",
        "y": r"several runs; one of (y\d, ){4}y\d \.\.\.; or @last",
        "abcdef": "'abcdef' begins several experiments; add digits: abcdef011111, abcdef111111",
        "@last-9": r"'@last-9' means no run; there are 9, from @last on",
        **dict.fromkeys(
            ("pull", "", "..", "/", "%", "PUSH", "x/push-s0-1", "/nowhere/pu", "f" * 6), "means no run; .*list"
        ),
    }
    for selector, told in refused.items():
        with pytest.raises(UsageError, match=told):
            query.find(store, selector)


def test_path_of_a_run_folder_means_no_other_run(store, tmp_path):
    run = indexed_run(store, tmp_path)
    copy = shutil.copytree(run.path, tmp_path / "elsewhere" / run.id)
    (tmp_path / "link").symlink_to(run.path)
    for path in (run.path, tmp_path / "link"):
        assert query.select(store, str(path)) == (run.summary(),)
    with pytest.raises(NoSuchRunError, match=r"the run folder .* is not in the index; name its runs folder"):
        query.select(store, str(copy))
    with pytest.raises(NoSuchRunError, match="means no run"):
        query.select(store, str(tmp_path / "elsewhere" / "reach"))


# Many at once.

MANY = """
import os, sys
from dataclasses import replace
from pathlib import Path
from karolos.records import labels
from karolos.store import Store
from karolos.records import RunFolder
from karolos.records.evaluation import Evaluation

runs, url, start = Path(sys.argv[1]), sys.argv[2], os.pipe()
children, flags = [], {name: (True,) for name in ("any", "end", "reset")}
for index in range(10):
    child = os.fork()
    if not child:
        os.close(start[1])
        os.read(start[0], 1)  # all begin at once
        run = RunFolder.create(runs, "x", index)
        run.describe({"name": "x"}, experiment="same", source=runs)
        with Store(url) as store:
            store.add_records([run.record()])
            for steps in range(5):
                run.add_test(Evaluation.of(steps, 1.0, **flags, returns=(0.0,), lengths=(1,)))
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
def test_ten_processes_make_the_database_at_once_and_lose_nothing(tmp_path, kind):
    with empty_database(kind, tmp_path) as url:
        with RunFolder.create(tmp_path, "x", 99) as shared:
            shared.describe({"name": "x"}, experiment="same", source=tmp_path)
        shared.path.rename(tmp_path / "shared")
        subprocess.run([sys.executable, "-c", FORKS + MANY, str(tmp_path), url], check=True, timeout=60)
        with Store(url) as store:
            (labelled,) = store.runs(ids=[shared.id])
            assert set(labelled.tags) == {f"tag{index}" for index in range(10)}
            runs = store.runs(where="not seed = 99")
            assert {(run.seed, run.state, run.steps) for run in runs} == {(seed, "finished", 5) for seed in range(10)}
            assert all(len(record.tests) == 5 for record in store.records(runs))


def test_sqlite_on_a_network_share_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("karolos.system.network_share", lambda path: "nfs4")
    with pytest.raises(StoreError, match=r"SQLite loses data on a network share \(nfs4\)"):
        Store(Store.default_url(tmp_path))


@pytest.fixture(params=KINDS)
def any_store(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Store]:
    with empty_database(request.param, tmp_path) as url, Store(url) as found:
        yield found


def add(any_store: Store, runs: Path, seed: int, rate: float = 0.001, experiment: str = "a" * 64) -> RunFolder:
    spec = {"task": {"name": "reach"}, "agent": {"name": "sac", "learning_rate": rate, "hidden": [8, 8]}}
    with new_run(runs, f"exp-{experiment[0]}", seed, spec={"name": "x"} | spec, experiment=experiment) as run:
        run.set_state("finished", steps=100 * seed)
        any_store.add_records([run.record()])
        return run


def seeds(any_store: Store, where: str) -> list[int]:
    return sorted(run.seed for run in any_store.runs(where=where))


def test_filters_know_columns_settings_labels_and_versions(any_store, tmp_path):
    first, second, third = (
        add(any_store, tmp_path, 1),
        add(any_store, tmp_path, 2, 1e-4),
        add(any_store, tmp_path, 3, 1e-4),
    )
    labels.add_tags(first.path, ["good", "to show"])
    labels.set_note(second.path, 'fell "over"')
    before = any_store.version()
    assert any_store.runs()
    if any_store.engine.dialect.name == "sqlite":  # a server counts what other tests write at the same time
        assert any_store.version() == before
    for run in (first, second):
        any_store.refresh_labels(run)
    assert any_store.version() != before, "a reader notices"
    third.set_state("running")  # and nobody runs it
    any_store.add_records([third.record()])
    assert seeds(any_store, "task=reach and agent.learning_rate<1e-3") == [2, 3]
    assert seeds(any_store, "agent.learning_rate<1e-3 and state=finished") == [2]
    assert seeds(any_store, "state=lost") == [3]
    assert seeds(any_store, "tags=good") == seeds(any_store, "tags ~ SHOW") == [1]
    assert seeds(any_store, "tags != good") == [2, 3]
    assert seeds(any_store, "note ~ over") == seeds(any_store, """note = 'fell "over"'""") == [2]
    assert seeds(any_store, "note = null") == [1, 3]
    assert seeds(any_store, "agent.hidden = '[8, 8]' and seed >= 2") == [2, 3]
    assert seeds(any_store, "steps in (100, 300) or seed = 2") == [1, 2, 3]
    assert seeds(any_store, f"versions.karolos = {first.record().versions['karolos']}") == [1, 2, 3]
    assert seeds(any_store, f"folder = '{first.path}'") == [1]
    assert seeds(any_store, "created > 2020-01-01") == [1, 2, 3]
    assert [run.seed for run in any_store.runs(where="task=reach", limit=2)] == [3, 2]
    assert any_store.runs(where="tags=good") == (first.summary(),)


@pytest.mark.parametrize(
    ("where", "told"),
    [
        ("stat=finished", "filter, column 1: no run has 'stat'; did you mean state"),
        (
            "seed=1 and learning_rate<1",
            "filter, column 12: no run has 'learning_rate'; did you mean agent.learning_rate",
        ),
        ("versions.karlos=1", "no run has 'versions.karlos'; did you mean versions.karolos"),
        ("seed>one", "filter, column 6: 'one' is not a number, as seed is"),
        ("zzzzzzzz=1", "no run has 'zzzzzzzz'; `karolos runs show RUN` shows"),
    ],
)
def test_a_filter_that_can_match_no_run_says_why(any_store, tmp_path, where, told):
    add(any_store, tmp_path, 1)
    with pytest.raises(UsageError) as caught:
        any_store.runs(where=where)
    assert told in str(caught.value)


def test_selector_means_all_runs_of_an_experiment(any_store, tmp_path):
    ab, ac = "ab" * 32, "abac" * 16
    runs = [add(any_store, tmp_path, seed, experiment=ab if seed < 3 else ac) for seed in (1, 2, 3)]
    first, second, third = (run.summary() for run in runs)
    assert query.select(any_store, "exp-a") == (third, second, first)
    assert query.select(any_store, "ababab") == (second, first)
    assert query.select(any_store, "abacab") == (query.find(any_store, "abacab"),) == (third,)
    assert query.select(any_store, first.run[:8]) == (first,)
    for several in ("ababab", "exp-"):
        with pytest.raises(UsageError, match=f"'{several}' means several runs"):
            query.find(any_store, several)


def stored_densities(any_store: Store) -> list[tuple[float, int, float]]:
    rows = any_store.fetch(select(SUCCESSES).order_by(SUCCESSES.c.steps))
    return [(row.steps, row.runs, row.mode) for row in rows]


def test_densities_are_stored_until_a_test_or_a_run_is_added_or_removed(any_store, tmp_path):
    runs = [add(any_store, tmp_path, seed) for seed in (1, 2, 3)]
    ratios = {100.0: [1.0, 0.9, 0.2], 200.5: [0.5, 0.5, 0.5]}
    first = success_densities(any_store, "a" * 64, "end", ratios)
    for density, values in zip(first, ratios.values(), strict=True):
        for name, value in vars(kde(values)).items():
            assert np.array_equal(getattr(density, name), value)
    assert stored_densities(any_store) == [(100.0, 3, first[0].mode), (200.5, 3, 0.5)]
    with any_store.writing() as connection:
        connection.execute(update(SUCCESSES).values(mode=0.125))
    again = success_densities(any_store, "a" * 64, "end", ratios)
    assert [one.mode for one in again] == [0.125, 0.125], "read, not computed"
    assert np.array_equal(again[0].density, first[0].density)
    [other] = success_densities(any_store, "a" * 64, "end", {100.0: [1.0, 0.9, 0.3]})
    assert other.mode == kde([1.0, 0.9, 0.3]).mode, "of other ratios"
    for change in (
        lambda: any_store.remove_runs([runs[0].id]),
        lambda: any_store.add_records([runs[0].record()]),
    ):
        success_densities(any_store, "a" * 64, "any", ratios)
        change()
        assert stored_densities(any_store) == []


def test_database_that_may_only_be_read_still_answers(tmp_path):
    with Store(Store.default_url(tmp_path)) as any_store:
        run = add(any_store, tmp_path, 1)

        def read_only(connection: sqlite3.Connection, _: object) -> None:
            connection.execute("PRAGMA query_only = ON")

        event.listen(any_store.engine, "connect", read_only)
        assert [one.mode for one in success_densities(any_store, "a" * 64, "end", {100: [1.0]})] == [1.0]
        assert any_store.runs(where="task=reach") == (run.summary(),)
        with pytest.raises(StoreError, match="the database is read-only"):
            any_store.add_records([run.record()])


def database(store: Store) -> sqlite3.Connection:
    return sqlite3.connect(store.url.database or "", isolation_level=None, timeout=0)


def test_locked_database_is_told_after_the_time_limit_and_a_reader_does_not_wait_for_a_writer(store, tmp_path):
    run = indexed_run(store, tmp_path)
    with database(store) as other:
        other.execute("BEGIN IMMEDIATE")
        assert [found.run for found in store.runs()] == [run.id]
        other.execute("ROLLBACK")
        other.execute("BEGIN EXCLUSIVE")
        for ask in (lambda: store.add_records([run.record()]), store.runs):
            with pytest.raises(
                StoreError, match=r"karolos\.sqlite: another process keeps the database locked; wait for"
            ):
                ask()
        other.execute("ROLLBACK")
    store.add_records([run.record()])


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (f"UPDATE karolos_schema SET version = {SCHEMA + 1}", "a newer .*; move it away and run"),
        ("UPDATE karolos_schema SET version = 0", "an older .*; `karolos db upgrade`"),
        ("ALTER TABLE karolos_schema RENAME TO x", "this database belongs to another program; .*`karolos db reindex`"),
        (None, "the file is not a database; name another"),
    ],
)
def test_database_of_another_schema_or_of_something_else_is_refused_and_not_touched(store, content, told):
    path = Path(store.url.database or "")
    if content is None:
        path.write_text("steps,success\n" * 100)
    else:
        with database(store) as other:
            other.execute(content)
        other.close()
    before = path.read_bytes()
    with pytest.raises(StoreError, match=rf"karolos\.sqlite: {told}"):
        Store(str(store.url))
    assert path.read_bytes() == before


def test_damaged_database_is_told(store, tmp_path):
    for _ in range(50):
        bare(store, f"x{_}")
    path = Path(store.url.database or "")
    data = bytearray(path.read_bytes())
    for page in range(1, len(data) // 4096):
        data[page * 4096 : page * 4096 + 64] = b"\xff" * 64
    path.write_bytes(data)
    with pytest.raises(StoreError, match="the database is damaged; move it away and run"):
        Store(str(store.url)).runs()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("UPDATE runs SET tags = '[1'", "a column does not hold JSON"),
        ("UPDATE specs SET content = 'x'", "a column does not hold JSON"),
        ("UPDATE runs SET tags = '5'", "the row of the run reach-s3-"),
        ("UPDATE runs SET seed = 'x', steps = 'y'", "the row of the run reach-s3-"),
    ],
)
def test_damaged_row_is_told(store, tmp_path, change, told):
    indexed_run(store, tmp_path).release()
    with database(store) as other:
        other.execute(change)
    with pytest.raises(StoreError, match=told):
        store.records(store.runs())


def test_database_removed_while_a_run_goes_on_is_told_and_not_created_again(store, tmp_path):
    run = indexed_run(store, tmp_path)
    Path(store.url.database or "").unlink()
    with pytest.raises(StoreError, match="the database cannot be opened"):
        store.add_records([run.record()])
    assert not Path(store.url.database or "").exists()


@pytest.mark.parametrize("name", ["50%25", "Läb #1 %20"])
def test_database_lies_in_its_runs_folder_whatever_its_name_is(name, tmp_path):
    with Store(Store.default_url(tmp_path / name)) as store:
        assert store.name == Store.default_url(tmp_path / name)
    assert [path.relative_to(tmp_path) for path in tmp_path.rglob("*.sqlite")] == [Path(name, "karolos.sqlite")]
    assert Store.default_url("which?a=b").endswith("which%3Fa=b/karolos.sqlite".replace("/", os.sep))


def test_folder_or_file_in_the_way_of_the_database_is_told(tmp_path):
    (tmp_path / "karolos.sqlite").mkdir()
    with pytest.raises(StoreError, match="a folder is in the way of the database's file; move it away"):
        Store(Store.default_url(tmp_path))
    (tmp_path / "runs").write_text("")
    with pytest.raises(MachineError, match="a file is in the way of a folder"):
        Store(Store.default_url(tmp_path / "runs"))


URL = r"is not a database URL; e\.g\. sqlite|must name a file"


@pytest.mark.parametrize(
    ("url", "told"),
    [
        *((url, URL) for url in ("", "runs/karolos.sqlite", "sqlite://", "sqlite:///:memory:")),
        ("sqlite:///file:x?uri=true", URL),
        *((url, URL) for url in ("me:secret@host://x", "postgresql://me:secret@host:port/x")),
        ("nosql://me:secret@host/x", "the database driver is missing"),
        ("postgresql+nodriver://me:secret@host/x?password=secret", "the database driver is missing"),
    ],
)
def test_url_that_names_no_database_or_driver_is_told_without_the_password(url, told):
    with pytest.raises(StoreError, match=told) as caught:
        Store(url)
    assert "secret" not in str(caught.value)


def test_a_role_without_rights_is_not_told_to_check_the_server():
    refusal = type("Refusal", (Exception,), {"sqlstate": "42501"})("permission denied for table runs")
    told, url = r"denied for table runs.*another role in the URL", make_url("postgresql://reader@host/lab")
    with pytest.raises(StoreError, match=told), explained(url):
        raise ProgrammingError("UPDATE", {}, refusal)


def test_hints_for_a_server_name_no_file_to_move_away():
    url = make_url("postgresql://me@host/lab")
    with pytest.raises(StoreError, match=r"does not hold JSON; name an empty one with --database"), explained(url):
        raise json.JSONDecodeError("bad", "{", 0)
    refusal = Exception('FATAL: password authentication failed for user "me"')
    with pytest.raises(StoreError, match=r"authentication failed.*check .* password and name"), explained(url):
        raise OperationalError("connect", {}, refusal)


def test_full_disk_is_told_and_loses_nothing_stored(store):
    stored: list[RunSummary] = []

    def fill(store: Store) -> None:
        for index in range(500):
            stored.append(bare(store, f"x{index:02}", error="e" * 1000))

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))
    try:
        with pytest.raises(StoreError, match=r"full; free some space|full or fails; check the disk"):
            fill(store)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert 0 < len(stored) < 500
    assert set(store.runs()) == set(stored)


def test_settings_of_sqlite_hold(store):
    with store.engine.connect() as connection:
        pragmas = [connection.exec_driver_sql(f"PRAGMA {name}").scalar() for name in ("foreign_keys", "synchronous")]
        assert pragmas == [1, 2]
        assert connection.exec_driver_sql("PRAGMA journal_mode").scalar() == "delete"
        assert connection.exec_driver_sql("PRAGMA busy_timeout").scalar() == 100
