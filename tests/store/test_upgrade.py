from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import create_engine, inspect
from support.databases import KINDS, empty_database

from karolos.errors import StoreError
from karolos.store import Store
from karolos.store.tables import SCHEMA, TABLES
from karolos.store.upgrade import upgrade

ASSETS = Path(__file__).parent / "assets"
"""schema<N>.sql: a database as the karolos of that schema left it; schema<N>.json: what it answered."""
OLD = sorted(int(path.stem.removeprefix("schema")) for path in ASSETS.glob("schema*.sql"))


@pytest.fixture(params=KINDS)
def url(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    with empty_database(request.param, tmp_path) as found:
        yield found


def fill(url: str, version: int) -> None:
    script = (ASSETS / f"schema{version}.sql").read_text()
    engine = create_engine(url)
    with engine.begin() as connection:
        for statement in script.split(";\n"):
            if statement.strip() and statement not in {"BEGIN TRANSACTION", "COMMIT"}:
                connection.exec_driver_sql(statement.replace("%", "%%"))
    engine.dispose()


def file(url: str) -> Path:
    return Path(url.removeprefix("sqlite:///"))


def test_every_schema_before_this_one_is_kept_as_an_asset() -> None:
    assert list(range(1, SCHEMA)) == OLD


@pytest.mark.parametrize("version", OLD)
def test_upgraded_database_gives_the_same_answers(url: str, version: int) -> None:
    fill(url, version)
    with pytest.raises(StoreError, match=r"an older karolos made this database .*; `karolos db upgrade` brings"):
        Store(url)
    done = upgrade(url)
    assert (done.before, done.after) == (version, SCHEMA)
    expected = json.loads((ASSETS / f"schema{version}.json").read_text())
    with Store(url) as store:
        runs = [run.row() for run in store.runs()]
        assert [{key: run[key] for key in before} for run, before in zip(runs, expected["runs"], strict=True)] == (
            expected["runs"]
        )
        assert {run["run"]: [asdict(test) for test in store.tests(run["run"])] for run in runs} == expected["tests"]
        assert {name: store.spec(name) for name in expected["specs"]} == expected["specs"]
        assert [run.name for run in store.runs(where="agent.learning_rate < 1e-3")] == ["toy"]


@pytest.mark.parametrize("version", OLD)
def test_upgraded_tables_are_those_of_a_new_database(url: str, version: int) -> None:
    fill(url, version)
    upgrade(url)
    engine = create_engine(url)
    with engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, TABLES) == []
        # Alembic does not compare what happens to rows that refer to a removed one.
        kept = {key["name"] or "": key["options"] for key in inspect(connection).get_foreign_keys("tests")}
        assert list(kept.values()) == [{"ondelete": "CASCADE"}]
    engine.dispose()


def test_upgrade_keeps_a_copy_of_the_file_and_a_second_one_does_nothing(tmp_path: Path) -> None:
    url = Store.default_url(tmp_path)
    fill(url, 1)
    (tmp_path / "karolos.sqlite.schema1").write_text("an earlier copy")
    backup = upgrade(url).backup
    assert backup == tmp_path / "karolos.sqlite.schema1-2"
    with sqlite3.connect(backup) as copy:
        assert copy.execute("SELECT version FROM karolos_schema").fetchall() == [(1,)]
        assert copy.execute("SELECT count(*) FROM tests").fetchall() == [(4,)]
    again = upgrade(url)
    assert (again.before, again.after, again.backup) == (SCHEMA, SCHEMA, None)
    assert (tmp_path / "karolos.sqlite.schema1").read_text() == "an earlier copy"


def test_upgrade_that_fails_leaves_the_database_as_it_was(tmp_path: Path) -> None:
    url = Store.default_url(tmp_path)
    fill(url, 1)
    with sqlite3.connect(file(url)) as connection:
        connection.execute("INSERT INTO tests VALUES ('of no run', 1, 1.0, 1, 1, 1, 0)")
    connection.close()
    with pytest.raises(StoreError, match="contradicts itself, so it was left as it is"):
        upgrade(url)
    with sqlite3.connect(file(url)) as connection:
        assert connection.execute("SELECT version FROM karolos_schema").fetchall() == [(1,)]
        tables = {row[0] for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    assert tables == {"experiments", "karolos_schema", "runs", "tests"}


def test_upgrade_waits_for_whoever_writes_and_says_so(tmp_path: Path) -> None:
    url = Store.default_url(tmp_path)
    fill(url, 1)
    other = sqlite3.connect(file(url), isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    with pytest.raises(StoreError, match="another process keeps it locked"):
        upgrade(url, timeout=0.1)
    other.execute("ROLLBACK")
    assert upgrade(url, timeout=0.1).after == SCHEMA


def test_upgrade_refuses_what_is_missing_foreign_or_newer(tmp_path: Path) -> None:
    url = Store.default_url(tmp_path)
    with pytest.raises(StoreError, match="there is no database; `karolos db reindex` makes one"):
        upgrade(url)
    assert not file(url).exists()
    with sqlite3.connect(file(url)) as connection:
        connection.execute("CREATE TABLE other (x)")
    with pytest.raises(StoreError, match="belongs to something else"):
        upgrade(url)
    with sqlite3.connect(file(url)) as connection:
        connection.execute("DROP TABLE other")
    with pytest.raises(StoreError, match="the database is empty"):
        upgrade(url)
    with Store(url) as store, store._engine.begin() as connection:
        connection.exec_driver_sql(f"UPDATE karolos_schema SET version = {SCHEMA + 1}")
    with pytest.raises(StoreError, match="a newer karolos made this database"):
        upgrade(url)
