"""The database says what the folders say, whatever was done before, and a damaged folder is named and left out."""

import itertools
import json
import shutil
import sqlite3
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from karolos_cli import db
from support.commands import call
from support.databases import KINDS, empty_database
from support.run_samples import new_run, result, stored

from karolos.records import RunFolder, labels, trash
from karolos.records.archive import export_runs, import_runs
from karolos.records.run_records import RunRecord
from karolos.store import Store, check, reindex
from karolos.store.database import RefusedValueError
from karolos.store.experiments import success_densities
from karolos.store.tables import TABLES

texts = st.text(st.characters(exclude_categories=["Cs", "Cc"]), min_size=1, max_size=5).filter(
    lambda text: text.strip()
)
which = st.integers(0, 5)
operations = st.lists(
    st.one_of(
        st.tuples(st.just("run"), st.sampled_from("ab"), st.floats(1e-4, 1e-2), st.sampled_from(["1.0", "2.0"])),
        st.tuples(st.just("test"), which, st.integers(0, 3), st.integers(0, 20)),
        st.tuples(st.just("state"), which, st.sampled_from(["running", "finished", "failed", "stopped"])),
        st.tuples(st.just("tag"), which, texts.map(str.strip)),
        st.tuples(st.just("untag"), which, texts.map(str.strip)),
        st.tuples(st.just("note"), which, texts),
        st.tuples(st.just("remove"), which),
        st.tuples(st.just("restore"), which),
        st.tuples(st.just("densities"), st.sampled_from("ab")),
    ),
    min_size=1,
    max_size=20,
)


CHANGES: dict[str, Callable[..., object]] = {
    "test": lambda folder, steps, successes: folder.add_test(result(steps, successes)),
    "state": lambda folder, state: folder.set_state(state, steps=7),
    "tag": lambda folder, tag: labels.add_tags(folder.path, [tag]),
    "untag": lambda folder, tag: labels.remove_tags(folder.path, [*folder.labels().tags[:1], tag]),
    "note": lambda folder, note: labels.set_note(folder.path, note),
}
"""What changes a run in its folder."""


@dataclass
class World:
    """A runs folder and its index, changed as commands and runs do it."""

    runs: Path
    store: Store
    folders: list[RunFolder] = field(default_factory=list)
    thrown: list[Path] = field(default_factory=list)
    number: Any = field(default_factory=itertools.count)

    def apply(self, operation: str, *values: Any) -> None:
        if operation == "run":
            self._run(*values)
        elif operation == "densities":
            densities(self.store, values[0])
        elif operation == "restore":
            if self.thrown:
                folder = trash.restore(self.thrown.pop(values[0] % len(self.thrown)))
                self.store.add_records([folder.record()])
                self.folders.append(folder)
        elif self.folders:
            folder = self.folders[values[0] % len(self.folders)]
            if operation == "remove":
                self.folders.remove(folder)
                self.thrown.append(trash.throw_away(folder))
                self.store.remove_runs([folder.id])
                return
            CHANGES[operation](folder, *values[1:])
            if operation in ("test", "state"):
                self.store.add_records([folder.record()])
            else:
                self.store.refresh_labels(folder)

    def _run(self, experiment: str, rate: float, version: str) -> None:
        folder = RunFolder.create(self.runs, "x", next(self.number))
        spec = {"name": "x", "agent": {"name": "sac", "learning_rate": rate}, "seeds": [1]}
        folder.describe(spec, experiment=experiment, source=self.runs)
        run = folder.path / "run.json"
        run.write_text(json.dumps(json.loads(run.read_text()) | {"versions": {"karolos": version}}))
        folder.release()
        folder = RunFolder.open(folder.path)
        self.store.add_records([folder.record()])
        self.folders.append(folder)


def densities(store: Store, experiment: str) -> list[tuple[float, float]]:
    ratios: dict[float, list[float]] = {}
    for record in store.records(store.runs(experiment=experiment)):
        for test in record.tests:
            ratios.setdefault(test.steps, []).append(test.success_any or 0.0)
    return [(one.mode, one.mean) for one in success_densities(store, experiment, "any", ratios)]


def answers(store: Store) -> list[Any]:
    runs = store.runs()
    experiments = sorted({run.experiment for run in runs})
    return [
        store.records(runs),
        [densities(store, name) for name in experiments],
        sorted(len(store.runs(where=f"tags = {json.dumps(tag)}")) for run in runs for tag in run.tags),
    ]


def rows(store: Store) -> dict[str, int]:
    with store.engine.connect() as connection:
        names = sorted(table for table in TABLES.tables if table != "karolos_schema")
        return {name: connection.exec_driver_sql(f"SELECT count(*) FROM {name}").scalar_one() for name in names}


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=15, suppress_health_check=[HealthCheck.too_slow])
@given(operations)
def test_rebuilt_index_gives_the_same_answers_whatever_was_done(kind, done):
    with tempfile.TemporaryDirectory() as place:
        runs = Path(place) / "runs"
        runs.mkdir()
        with empty_database(kind, runs) as url, Store(url) as store:
            world = World(runs, store)
            for operation in done:
                world.apply(*operation)
            assert list(check(store, runs)) == []
            before, counted = answers(store), rows(store)
            reindex(store, runs)
            assert answers(store) == before
        with empty_database("sqlite", Path(place)) as url, Store(url) as store:
            reindex(store, runs)
            assert answers(store) == before
            assert rows(store) == counted  # and nothing is left of what was removed
            assert list(check(store, runs)) == []


def test_check_names_every_kind_of_difference(tmp_path):
    with Store(Store.default_url(tmp_path)) as store:
        world = World(tmp_path, store)
        for _ in range(6):
            world.apply("run", "a", 0.001, "1.0")
            world.apply("state", -1, "finished")  # a run that waits for its start is read from its folder
        unknown, gone, stale, untested, labelled, torn = world.folders
        store.remove_runs([unknown.id])
        gone.path.rename(tmp_path / "elsewhere.removed")
        (tmp_path / "elsewhere.removed" / "run.json").unlink()
        stale.set_state("finished", steps=9)
        untested.add_test(result(5, 3))
        labels.add_tags(labelled.path, ["good"])
        (torn.path / "tests.jsonl").write_text('{"steps":')
        with sqlite3.connect(tmp_path / "karolos.sqlite") as connection:  # without its foreign keys
            connection.execute("UPDATE specs SET content = '{}'")
            connection.execute("INSERT INTO tests VALUES ('no run', 1, 1.0, 1, null, null, null, null, '{}')")
        found: dict[str | None, list[str]] = {}
        for one in check(store, tmp_path):
            found.setdefault(one.run, []).append(one.what)
    assert found[None] == ["a row of tests refers to a missing row of runs"]
    others = "the settings of its spec differ in the database"
    assert found[unknown.id] == ["it has a folder, and is not in the database"]
    assert found[gone.id] == ["it is in the database, and its folder is gone"]
    assert others in found[stale.id]
    assert any(what == "the tests differ in the database" for what in found[untested.id])
    assert "tags is ['good'] in its folder and [] in the database" in found[labelled.id]
    assert any("tests.jsonl:1: the last line is torn" in what for what in found[torn.id])


@pytest.mark.parametrize("copy", ["z-copy", "a-copy"])
def test_two_folders_of_one_run_are_told_and_that_of_its_name_is_kept(tmp_path, copy):
    with Store(Store.default_url(tmp_path)) as store:
        world = World(tmp_path, store)
        world.apply("run", "a", 0.001, "1.0")
        (folder,) = world.folders
        shutil.copytree(folder.path, tmp_path / copy)
        done = reindex(store, tmp_path)
        assert done.runs == 1
        said = f"{copy}: says that it is the run {folder.id}, as {folder.id} does; left out; remove one of the two"
        assert any(said in problem for problem in done.problems)
        assert store.runs()[0].folder == str(folder.path)
        assert any(said in one.what for one in check(store, tmp_path))


def test_reindex_keeps_what_a_run_writes_meanwhile(tmp_path, monkeypatch):
    with Store(Store.default_url(tmp_path)) as store, RunFolder.create(tmp_path, "x", 0) as folder:
        folder.describe({}, experiment="a", source=tmp_path)
        folder.set_state("running")
        enter, left = store.add_records, [20, 10]

        def enter_after_the_run(records: Any) -> None:
            if left:
                folder.add_test(result(left.pop(), 3))
                enter([folder.record()])
            enter(records)

        monkeypatch.setattr(store, "add_records", enter_after_the_run)
        reindex(store, tmp_path)
        assert [test.steps for test in store.records(store.runs())[0].tests] == [test.steps for test in folder.tests()]
        assert not left, "also what it writes while that is entered"


def test_reindex_forgets_what_is_gone_and_keeps_what_lies_elsewhere(tmp_path):
    runs, elsewhere = tmp_path / "runs", tmp_path / "elsewhere"
    with Store(Store.default_url(tmp_path)) as store:
        for seed, place in enumerate((runs, runs, elsewhere)):
            with RunFolder.create(place, "x", seed) as folder:
                folder.describe({}, experiment="a", source=tmp_path)
                store.add_records([folder.record()])
        kept, gone, other = sorted(store.runs(), key=lambda run: run.seed)
        shutil.rmtree(gone.folder)
        shutil.rmtree(elsewhere)
        done = reindex(store, runs)
        assert (done.runs, done.forgotten) == (1, 1)
        assert set(store.runs()) == {kept, other}


DAMAGE = [
    *(("run.json", "seed", text) for text in ("9" * 5000, "-1", '"1"')),
    ("run.json", "experiment", "3"),
    *(("run.json", "versions", text) for text in ("[1]", '{"numpy": 2}')),
    *(("run.json", "git", text) for text in ('"abc"', "[1]", '{"commit": 7}')),
    *(("run.json", "command", text) for text in ("5", "[1]")),
    *(("run.json", "created", text) for text in ("null", '"\\ud800"')),
    *(("run.json", "id", text) for text in ('"../x"', '"sweeps"')),
    *(("state.json", "steps", text) for text in ("Infinity", str(1 << 64))),
    ("state.json", "attempt", "null"),
    ("state.json", "state", '"done"'),
    ("state.json", "seconds", "1e999"),
    ("state.json", "error", '"\\ud800"'),
    *(("resolved.json", "note", text) for text in ("NaN", '"\\ud800"', "[" * 300 + "]" * 300)),
]
"""Values with which a file of a run is damaged."""


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


def damaged(runs: Path, values: Iterable[tuple[str, str, str]]) -> dict[str, tuple[str, str, str]]:
    """A finished run for each file, key and text that damages it; the damage by the ids of the runs."""
    found = {}
    for seed, (file, key, text) in enumerate(values):
        with new_run(runs, seed=seed) as bad:
            bad.set_state("finished", steps=10)
        put(bad, file, key, text)
        found[bad.id] = file, key, text
    return found


def named(run: str, problems: Iterable[str]) -> list[str]:
    return [problem for problem in problems if run in problem]


def test_folders_without_a_description_are_named_and_of_others_what_can_be_read_is_indexed(store, tmp_path):
    with new_run(tmp_path, seed=99) as good:
        pass
    bad = damaged(tmp_path, DAMAGE)
    done = reindex(store, tmp_path)
    described = {run for run, (file, *_) in bad.items() if file != "run.json"}
    assert {run.run for run in store.runs()} == {good.id, *described}
    assert done.runs == len(store.runs())
    for problems in (done.problems, [found.what for found in check(store, tmp_path)]):
        assert len(problems) == len(bad)
        for run, (file, *value) in bad.items():
            (problem,) = named(run, problems)
            assert "\n" not in problem, value
            assert file == "run.json" or problem.startswith(f"{run}: {file}: missing"), value


def test_odd_values_are_stored_or_their_runs_are_named(store, tmp_path):
    with new_run(tmp_path, seed=99) as good:
        pass
    texts = ('"\\u0000"', '"1e999"', "1e999", "[" * 60 + "]" * 60, '"' + "x" * 1000 + '"')
    places = (("state.json", "error"), ("run.json", "versions"), ("resolved.json", "note"))
    bad = damaged(
        tmp_path,
        [
            (file, key, f'{{"x": {text}}}' if key == "versions" else text)
            for text, (file, key) in itertools.product(texts, places)
        ],
    )
    done = reindex(store, tmp_path)
    indexed = {run.run for run in store.runs()}
    assert good.id in indexed
    for run, damage in bad.items():
        assert run in indexed or len(named(run, done.problems)) == 1, damage
    assert [one for one in check(store, tmp_path) if one.run == good.id] == []


def test_tests_with_impossible_numbers_are_left_out(store, tmp_path):
    for seed, (old, new) in enumerate(
        (('"seconds":0.1', '"seconds":NaN'), ('"seconds":0.1', '"seconds":1e999'), ('"steps":10', f'"steps":{1 << 64}'))
    ):
        with new_run(tmp_path, seed=seed) as bad:
            bad.add_test(result(10, 3))
            bad.add_test(result(20, 4))
        file = bad.path / "tests.jsonl"
        file.write_text(file.read_text().replace(old, new))
        assert ["tests.jsonl" in one for one in named(bad.id, reindex(store, tmp_path).problems)] == [True], new
        assert [test.steps for test in stored(store, bad.id).tests] == [20], new


def test_a_run_that_the_database_refuses_is_named_and_the_others_are_entered(tmp_path):
    with new_run(tmp_path) as good, new_run(tmp_path) as bad:
        pass
    with Store(Store.default_url(tmp_path)) as store:
        with store.writing() as connection:
            rule = f"WHEN new.run = '{bad.id}' BEGIN SELECT RAISE(ABORT, 'not this one'); END"
            connection.exec_driver_sql(f"CREATE TRIGGER refuse BEFORE INSERT ON runs {rule}")
        done = reindex(store, tmp_path)
        assert (done.runs, done.problems) == (1, (f"{bad.id}: the database refuses a value (not this one); left out",))
        assert [run.run for run in store.runs()] == [good.id]
    code, _, told = call(db.app, "reindex", "--runs", str(tmp_path))
    assert code == 1
    assert "not this one" in told
    assert "1 run entered" in told
    assert call(db.app, "check", "--runs", str(tmp_path))[0] == 4


def test_an_archive_with_a_run_that_the_database_refuses_brings_nothing(tmp_path):
    with new_run(tmp_path / "a") as run:
        pass
    export_runs([run], tmp_path / "x.tar.gz")

    def refuse(records: Sequence[RunRecord]) -> None:
        assert [record.summary.run for record in records] == [run.id]
        raise RefusedValueError("no", where="here", hint="none")

    with pytest.raises(RefusedValueError):
        import_runs(tmp_path / "x.tar.gz", tmp_path / "b", enter=refuse)
    assert list((tmp_path / "b").iterdir()) == []
