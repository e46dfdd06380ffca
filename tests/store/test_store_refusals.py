from __future__ import annotations

import resource
import sqlite3
from pathlib import Path

import pytest
from sqlalchemy import create_engine, make_url
from support.run_samples import bare, indexed_run

from karolos.errors import MachineError, StoreError
from karolos.records.run_records import RunSummary
from karolos.store import Store
from karolos.store.database import explained
from karolos.store.tables import SCHEMA


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(Store.default_url(tmp_path), timeout=0.1)


def database(store: Store) -> sqlite3.Connection:
    return sqlite3.connect(store.database.url.database or "", isolation_level=None, timeout=0)


def test_locked_database_is_told_after_the_time_limit(store: Store, tmp_path: Path) -> None:
    run = indexed_run(store, tmp_path)
    with database(store) as other:
        other.execute("BEGIN EXCLUSIVE")
        with pytest.raises(StoreError, match=r"karolos\.sqlite: another process keeps the database locked; wait for"):
            store.add_records([run.record()])
        with pytest.raises(StoreError, match="another process keeps the database locked"):
            store.runs()
        other.execute("ROLLBACK")
    store.add_records([run.record()])


def test_reader_does_not_wait_for_a_writer(store: Store, tmp_path: Path) -> None:
    run = indexed_run(store, tmp_path)
    with database(store) as other:
        other.execute("BEGIN IMMEDIATE")
        assert [found.run for found in store.runs()] == [run.id]


@pytest.mark.parametrize(
    ("version", "told"), [(SCHEMA + 1, "a newer .*; move it away and run"), (0, "an older .*; `karolos db upgrade`")]
)
def test_database_of_another_schema_is_refused_and_not_touched(store: Store, version: int, told: str) -> None:
    with database(store) as other:
        other.execute("UPDATE karolos_schema SET version = ?", [version])
    other.close()
    content = Path(store.database.url.database or "").read_bytes()
    with pytest.raises(StoreError, match=told):
        Store(str(store.database.url))
    assert Path(store.database.url.database or "").read_bytes() == content


def test_database_of_something_else_is_refused_and_not_touched(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "other.sqlite") as other:
        other.execute("CREATE TABLE alembic_version (x)")
    other.close()
    content = (tmp_path / "other.sqlite").read_bytes()
    with pytest.raises(
        StoreError, match=r"other\.sqlite: this database belongs to another program; .*`karolos db reindex`"
    ):
        Store(f"sqlite:///{tmp_path}/other.sqlite")
    assert (tmp_path / "other.sqlite").read_bytes() == content


def test_file_that_is_no_database_is_refused(tmp_path: Path) -> None:
    (tmp_path / "karolos.sqlite").write_text("steps,success\n" * 100)
    with pytest.raises(StoreError, match=r"the file is not a database; name another"):
        Store(Store.default_url(tmp_path))
    assert (tmp_path / "karolos.sqlite").read_text().startswith("steps,success")


def test_damaged_database_is_told(store: Store, tmp_path: Path) -> None:
    for _ in range(50):
        bare(store, f"x{_}")
    path = Path(store.database.url.database or "")
    data = bytearray(path.read_bytes())
    for page in range(1, len(data) // 4096):
        data[page * 4096 : page * 4096 + 64] = b"\xff" * 64
    path.write_bytes(data)
    with pytest.raises(StoreError, match="the database is damaged; move it away and run"):
        Store(str(store.database.url)).runs()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("UPDATE runs SET tags = '[1'", "a column does not hold JSON"),
        ("UPDATE specs SET content = 'x'", "a column does not hold JSON"),
        ("UPDATE runs SET tags = '5'", "the row of the run reach-s3-"),
        ("UPDATE runs SET seed = 'x', steps = 'y'", "the row of the run reach-s3-"),
    ],
)
def test_damaged_row_is_told(store: Store, tmp_path: Path, change: str, told: str) -> None:
    indexed_run(store, tmp_path).release()
    with database(store) as other:
        other.execute(change)
    with pytest.raises(StoreError, match=told):
        store.records(store.runs())


def test_read_only_database_is_told(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "x.sqlite") as other:
        other.execute("CREATE TABLE x (y)")
    url = make_url(f"sqlite:///{tmp_path}/x.sqlite")
    engine = create_engine("sqlite://", creator=lambda: sqlite3.connect(f"file:{tmp_path}/x.sqlite?mode=ro", uri=True))
    with pytest.raises(StoreError, match=r"x\.sqlite: the database is read-only"), explained(url):  # noqa: SIM117
        with engine.begin() as connection:
            connection.exec_driver_sql("INSERT INTO x VALUES (1)")


def test_database_removed_while_a_run_goes_on_is_told_and_not_created_again(store: Store, tmp_path: Path) -> None:
    run = indexed_run(store, tmp_path)
    Path(store.database.url.database or "").unlink()
    with pytest.raises(StoreError, match="the database cannot be opened"):
        store.add_records([run.record()])
    assert not Path(store.database.url.database or "").exists()


def test_folder_in_place_of_the_database_is_told(tmp_path: Path) -> None:
    (tmp_path / "karolos.sqlite").mkdir()
    with pytest.raises(StoreError, match="cannot be opened"):
        Store(Store.default_url(tmp_path))


def test_file_in_place_of_its_folder_is_told(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("")
    with pytest.raises(MachineError, match="a file is in the way of a folder"):
        Store(Store.default_url(tmp_path / "runs"))


@pytest.mark.parametrize(
    "url", ["", "runs/karolos.sqlite", "sqlite://", "sqlite:///:memory:", "sqlite:///file:x?uri=true"]
)
def test_url_that_names_no_database_is_told(url: str) -> None:
    with pytest.raises(StoreError, match=r"is not a database URL; e\.g\. sqlite|must name a file"):
        Store(url)


@pytest.mark.parametrize(
    "url",
    [
        "nosql://me:secret@host/x",
        "postgresql+nodriver://me:secret@host/x?password=secret",
        "me:secret@host://x",
        "postgresql://me:secret@host:port/x",
    ],
)
def test_driver_that_is_missing_is_told_without_the_password(url: str) -> None:
    with pytest.raises(StoreError) as caught:
        Store(url)
    assert "secret" not in str(caught.value)


def test_full_disk_is_told_and_loses_nothing_stored(store: Store) -> None:
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


def test_settings_of_sqlite_hold(store: Store) -> None:
    with store.database.engine.connect() as connection:
        pragmas = [connection.exec_driver_sql(f"PRAGMA {name}").scalar() for name in ("foreign_keys", "synchronous")]
        assert pragmas == [1, 2]
        assert connection.exec_driver_sql("PRAGMA journal_mode").scalar() == "delete"
        assert connection.exec_driver_sql("PRAGMA busy_timeout").scalar() == 100
