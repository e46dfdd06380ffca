"""A damaged run folder is named and left out; the index of the other runs does not suffer."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from karolos_cli import db
from support.commands import call
from support.databases import KINDS, empty_database
from support.run_samples import new_run, result

from karolos.errors import UsageError
from karolos.records import RunFolder
from karolos.records.archive import export_runs, import_runs
from karolos.store import Store, check, reindex

DAMAGE: list[tuple[str, str, Any]] = [
    ("state.json", "seconds", "1e999"),
    ("state.json", "steps", str(1 << 64)),
    ("state.json", "attempt", str(1 << 40)),
    ("state.json", "error", '"\\ud800"'),
    ("state.json", "error", '"\\u0000"'),
    ("run.json", "seed", "9" * 240),
    ("run.json", "seed", "-1"),
    ("run.json", "experiment", json.dumps("e" * 129)),
    ("run.json", "versions", '{"torch": "\\u0000"}'),
    ("run.json", "versions", "[1]"),
    ("run.json", "git", "[1]"),
    ("run.json", "command", "[1]"),
    ("run.json", "created", '"\\ud800"'),
    ("resolved.json", "note", '"\\u0000"'),
    ("resolved.json", "note", "1e999"),
    ("resolved.json", "note", "[" * 60 + "]" * 60),
]
MISREAD: list[tuple[str, str, Any]] = [
    ("state.json", "steps", "Infinity"),
    ("state.json", "steps", "1e999"),
    ("state.json", "seconds", "NaN"),
    ("resolved.json", "note", "NaN"),
]


def put(folder: RunFolder, file: str, key: str, text: str) -> None:
    """Set a value of a JSON file to a text that `json.dumps` would not write."""
    row = json.loads((folder.path / file).read_text())
    (folder.path / file).write_text(json.dumps({**row, key: "HERE"}).replace('"HERE"', text))


@pytest.fixture(params=KINDS)
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Store]:
    with empty_database(request.param, tmp_path) as url, Store(url) as store:
        yield store


@pytest.mark.parametrize(("file", "key", "text"), DAMAGE)
def test_a_folder_that_cannot_be_stored_is_named_and_the_others_are_indexed(
    store: Store, tmp_path: Path, file: str, key: str, text: str
) -> None:
    good, bad = new_run(tmp_path), new_run(tmp_path)
    for folder in (good, bad):
        folder.add_test(result(10, 3))
        folder.set_state("finished", steps=10)
        folder.release()
    put(bad, file, key, text)
    done = reindex(store, tmp_path)
    assert [run.run for run in store.runs()] == [good.id]
    assert done.runs == 1
    assert len(done.problems) == 1
    assert bad.id in done.problems[0]
    assert "\n" not in done.problems[0]
    assert [bad.id in found.what for found in check(store, tmp_path)] == [True]


@pytest.mark.parametrize(("file", "key", "text"), MISREAD)
def test_a_file_that_is_not_json_is_named_and_the_rest_of_the_folder_is_indexed(
    store: Store, tmp_path: Path, file: str, key: str, text: str
) -> None:
    with new_run(tmp_path) as bad:
        bad.set_state("finished", steps=10)
    put(bad, file, key, text)
    assert reindex(store, tmp_path).problems == (f"{bad.id}: {file}: missing or damaged",)
    assert [run.run for run in store.runs()] == [bad.id]


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
    assert [test.steps for test in store.tests(bad.id)] == [20]


def test_commands_name_the_folder_and_exit_with_1(tmp_path: Path) -> None:
    with new_run(tmp_path / "runs"), new_run(tmp_path / "runs") as bad:
        pass
    put(bad, "state.json", "error", '"\\ud800"')
    code, _, told = call(db.app, "reindex", "--runs", str(tmp_path / "runs"))
    assert code == 1
    assert f"{bad.id}: error contains a lone surrogate; the run is left out" in told
    assert "1 runs entered" in told
    assert call(db.app, "check", "--runs", str(tmp_path / "runs"))[0] == 4


def test_an_archive_with_a_run_that_cannot_be_stored_brings_nothing(tmp_path: Path) -> None:
    with new_run(tmp_path / "a") as good, new_run(tmp_path / "a") as bad:
        pass
    put(bad, "state.json", "error", '"\\ud800"')
    export_runs([good, bad], tmp_path / "x.zip")
    with pytest.raises(UsageError, match="lone surrogate"):
        import_runs(tmp_path / "x.zip", tmp_path / "b")
    assert list((tmp_path / "b").iterdir()) == []
