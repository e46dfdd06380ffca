"""A damaged run folder is named and left out; the index of the other runs does not suffer."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from hashlib import sha256
from pathlib import Path

import pytest
from karolos_cli import db
from support.commands import call
from support.databases import KINDS, empty_database
from support.run_samples import new_run, result, stored

from karolos.records import RunFolder
from karolos.records.archive import export_runs, import_runs
from karolos.records.run_records import RunRecord
from karolos.store import Store, check, reindex
from karolos.store.database import RefusedValueError

DAMAGE = [
    ("seed", "9" * 5000),
    ("seed", "-1"),
    ("experiment", "3"),
    ("versions", "[1]"),
    ("git", "[1]"),
    ("command", "[1]"),
    ("created", '"\\ud800"'),
    ("id", '"../x"'),
    ("id", '"sweeps"'),
]
"""Values with which run.json is damaged."""
MISREAD = [
    ("state.json", "steps", "Infinity"),
    ("state.json", "steps", str(1 << 64)),
    ("state.json", "attempt", "null"),
    ("state.json", "state", '"done"'),
    ("state.json", "seconds", "1e999"),
    ("state.json", "error", '"\\ud800"'),
    ("resolved.json", "note", "NaN"),
    ("resolved.json", "note", '"\\ud800"'),
    ("resolved.json", "note", "[" * 300 + "]" * 300),
]
"""Values with which another file is damaged."""


def put(folder: RunFolder, file: str, key: str, text: str) -> None:
    """Set a value of a JSON file to a text that `json.dumps` would not write."""
    row = json.loads((folder.path / file).read_text())
    (folder.path / file).write_text(json.dumps({**row, key: "HERE"}).replace('"HERE"', text))
    if file == "resolved.json":  # as if the run had begun with it
        run = json.loads((folder.path / "run.json").read_text())
        made = sha256((folder.path / file).read_bytes()).hexdigest()
        (folder.path / "run.json").write_text(json.dumps(run | {"resolved_sha256": made}))


@pytest.fixture(params=KINDS)
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Store]:
    with empty_database(request.param, tmp_path) as url, Store(url) as store:
        yield store


@pytest.mark.parametrize(("key", "text"), DAMAGE)
def test_a_folder_without_a_description_is_named_and_the_others_are_indexed(
    store: Store, tmp_path: Path, key: str, text: str
) -> None:
    with new_run(tmp_path) as good, new_run(tmp_path) as bad:
        pass
    put(bad, "run.json", key, text)
    done = reindex(store, tmp_path)
    assert [run.run for run in store.runs()] == [good.id]
    assert done.runs == 1
    assert [bad.id in problem and "\n" not in problem for problem in done.problems] == [True]
    assert [bad.id in found.what for found in check(store, tmp_path)] == [True]


@pytest.mark.parametrize(("file", "key", "text"), MISREAD)
def test_a_file_that_cannot_be_read_is_named_and_the_rest_of_the_folder_is_indexed(
    store: Store, tmp_path: Path, file: str, key: str, text: str
) -> None:
    with new_run(tmp_path) as bad:
        bad.set_state("finished", steps=10)
    put(bad, file, key, text)
    (problem,) = reindex(store, tmp_path).problems
    assert problem.startswith(f"{bad.id}: {file}: missing")
    assert [run.run for run in store.runs()] == [bad.id]
    assert [one.what for one in check(store, tmp_path)] == [problem]


@pytest.mark.parametrize(
    ("file", "key"), [("state.json", "error"), ("run.json", "versions"), ("resolved.json", "note")]
)
@pytest.mark.parametrize("text", ['"\\u0000"', '"1e999"', "1e999", "[" * 60 + "]" * 60, '"' + "x" * 1000 + '"'])
def test_an_odd_value_is_stored_or_its_run_is_named(
    store: Store, tmp_path: Path, file: str, key: str, text: str
) -> None:
    with new_run(tmp_path) as good, new_run(tmp_path) as bad:
        pass
    put(bad, file, key, f'{{"x": {text}}}' if key == "versions" else text)
    done = reindex(store, tmp_path)
    indexed = {run.run for run in store.runs()}
    assert indexed == {good.id, bad.id} or (indexed == {good.id} and [bad.id in one for one in done.problems] == [True])
    assert [one for one in check(store, tmp_path) if one.run == good.id] == []


@pytest.mark.parametrize(
    "change",
    [('"seconds":0.1', '"seconds":NaN'), ('"seconds":0.1', '"seconds":1e999'), ('"steps":10', f'"steps":{1 << 64}')],
)
def test_a_test_with_impossible_numbers_is_left_out(store: Store, tmp_path: Path, change: tuple[str, str]) -> None:
    with new_run(tmp_path) as bad:
        bad.add_test(result(10, 3))
        bad.add_test(result(20, 4))
    file = bad.path / "tests.jsonl"
    file.write_text(file.read_text().replace(*change))
    (problem,) = reindex(store, tmp_path).problems
    assert "tests.jsonl" in problem
    assert [test.steps for test in stored(store, bad.id).tests] == [20]


def test_a_run_that_the_database_refuses_is_named_and_the_others_are_entered(tmp_path: Path) -> None:
    with new_run(tmp_path) as good, new_run(tmp_path) as bad:
        pass
    with Store(Store.default_url(tmp_path)) as store:
        with store.database.writing() as connection:
            rule = f"WHEN new.run = '{bad.id}' BEGIN SELECT RAISE(ABORT, 'not this one'); END"
            connection.exec_driver_sql(f"CREATE TRIGGER refuse BEFORE INSERT ON runs {rule}")
        done = reindex(store, tmp_path)
        assert (done.runs, done.problems) == (1, (f"{bad.id}: the database refuses a value (not this one); left out",))
        assert [run.run for run in store.runs()] == [good.id]
    code, _, told = call(db.app, "reindex", "--runs", str(tmp_path))
    assert code == 1
    assert "not this one" in told
    assert "1 runs entered" in told
    assert call(db.app, "check", "--runs", str(tmp_path))[0] == 4


def test_an_archive_with_a_run_that_the_database_refuses_brings_nothing(tmp_path: Path) -> None:
    with new_run(tmp_path / "a") as run:
        pass
    export_runs([run], tmp_path / "x.tar.gz")

    def refuse(records: Sequence[RunRecord]) -> None:
        assert [record.summary.run for record in records] == [run.id]
        raise RefusedValueError("no", where="here", hint="none")

    with pytest.raises(RefusedValueError):
        import_runs(tmp_path / "x.tar.gz", tmp_path / "b", enter=refuse)
    assert list((tmp_path / "b").iterdir()) == []
