"""The database says what the folders say, whatever was done before."""

from __future__ import annotations

import itertools
import json
import shutil
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.databases import KINDS, empty_database
from support.run_samples import result
from support.sweep_samples import some_trial, write_sweep

from karolos.files import FileLock
from karolos.records import RunFolder, labels, trash
from karolos.records.sweep_records import SweepFinal, SweepTrialState
from karolos.store import Store, check, reindex
from karolos.store.summaries import success_densities
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
        st.tuples(
            st.just("sweep"),
            st.sampled_from(["line", "other"]),
            st.lists(st.tuples(st.sampled_from(get_args(SweepTrialState)), st.floats(-1, 1)), max_size=3),
            st.booleans(),
        ),
        st.tuples(st.just("unsweep"), st.sampled_from(["line", "other"])),
    ),
    min_size=1,
    max_size=20,
)


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
        elif operation == "sweep":
            self._sweep(*values)
        elif operation == "unsweep":
            shutil.rmtree(self.runs / "sweeps" / values[0], ignore_errors=True)
            reindex(self.store, self.runs)
        elif operation == "densities":
            densities(self.store, values[0])
        elif operation == "restore":
            if self.thrown:
                folder = trash.restore(self.thrown.pop(values[0] % len(self.thrown)))
                self.store.add_records([folder.record()])
                self.folders.append(folder)
        elif self.folders:
            getattr(self, f"_{operation}")(self.folders[values[0] % len(self.folders)], *values[1:])

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

    def _sweep(self, name: str, trials: list[tuple[SweepTrialState, float]], with_final: bool) -> None:
        made = [some_trial(number, state, value) for number, (state, value) in enumerate(trials)]
        best = next((trial for trial in made if trial.values), None)
        final = None
        if with_final and best is not None:
            final = SweepFinal(best.number, (1,), (2,), best.values or (), {best.number: (0.25, 7.0)}, None)
        shutil.rmtree(self.runs / "sweeps" / name, ignore_errors=True)
        self.store.sweeps.add([write_sweep(self.runs, name, made, final)])

    def _test(self, folder: RunFolder, steps: int, successes: int) -> None:
        folder.add_test(result(steps, successes))
        self.store.add_records([folder.record()])

    def _state(self, folder: RunFolder, state: str) -> None:
        folder.set_state(state, steps=7)
        self.store.add_records([folder.record()])

    def _tag(self, folder: RunFolder, tag: str) -> None:
        labels.add_tags(folder.path, [tag])
        self.store.refresh_labels(folder)

    def _untag(self, folder: RunFolder, tag: str) -> None:
        labels.remove_tags(folder.path, [*folder.labels().tags[:1], tag])
        self.store.refresh_labels(folder)

    def _note(self, folder: RunFolder, note: str) -> None:
        labels.set_note(folder.path, note)
        self.store.refresh_labels(folder)

    def _remove(self, folder: RunFolder) -> None:
        self.folders.remove(folder)
        self.thrown.append(trash.throw_away(folder))
        self.store.remove_runs([folder.id])


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
        [(sweep, sweep.row(), sweep.best) for sweep in store.sweeps.all()],
        sorted(len(store.runs(where=f"tags = {json.dumps(tag)}")) for run in runs for tag in run.tags),
    ]


def rows(store: Store) -> dict[str, int]:
    with store.database.engine.connect() as connection:
        names = sorted(table for table in TABLES.tables if table != "karolos_schema")
        return {name: connection.exec_driver_sql(f"SELECT count(*) FROM {name}").scalar_one() for name in names}


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(operations)
def test_rebuilt_index_gives_the_same_answers_whatever_was_done(kind: str, done: list[tuple[Any, ...]]) -> None:
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


def test_check_names_every_kind_of_difference(tmp_path: Path) -> None:
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
        with store.database.engine.begin() as connection:
            connection.exec_driver_sql("PRAGMA foreign_keys = OFF")
            connection.exec_driver_sql("UPDATE specs SET content = '{}'")
        found: dict[str | None, list[str]] = {}
        for one in check(store, tmp_path):
            found.setdefault(one.run, []).append(one.what)
    others = "the settings of its spec differ in the database"
    assert found[unknown.id] == ["it has a folder, and is not in the database"]
    assert found[gone.id] == ["it is in the database, and its folder is gone"]
    assert others in found[stale.id]
    assert any(what == "the tests differ in the database" for what in found[untested.id])
    assert "tags is ['good'] in its folder and [] in the database" in found[labelled.id]
    assert any("tests.jsonl:1: the last line is torn" in what for what in found[torn.id])


def test_check_names_a_database_that_contradicts_itself(tmp_path: Path) -> None:
    with Store(Store.default_url(tmp_path)) as store:
        World(tmp_path, store).apply("run", "a", 0.001, "1.0")
        import sqlite3

        with sqlite3.connect(tmp_path / "karolos.sqlite") as connection:
            connection.execute("INSERT INTO trials VALUES ('no sweep', 1, 'x', 'failed', '{}', null, '[]', null)")
        assert [one.what for one in check(store, tmp_path)] == ["a row of trials refers to a missing row of sweeps"]


def test_two_folders_of_one_run_are_told_and_the_first_is_kept(tmp_path: Path) -> None:
    with Store(Store.default_url(tmp_path)) as store:
        world = World(tmp_path, store)
        world.apply("run", "a", 0.001, "1.0")
        (folder,) = world.folders
        shutil.copytree(folder.path, tmp_path / "z-copy")
        done = reindex(store, tmp_path)
        assert done.runs == 1
        assert any(f"z-copy: says that it is the run {folder.id}" in problem for problem in done.problems)
        assert store.runs()[0].folder == str(folder.path)
        assert any(f"z-copy: says that it is the run {folder.id}" in one.what for one in check(store, tmp_path))


def test_check_names_every_difference_of_a_sweep(tmp_path: Path) -> None:
    with Store(Store.default_url(tmp_path)) as store:
        records = [write_sweep(tmp_path, name, [some_trial(0)]) for name in ("fine", "gone", "stale", "torn", "going")]
        store.sweeps.add(records)
        write_sweep(tmp_path, "unknown", [])
        shutil.rmtree(tmp_path / "sweeps" / "gone")
        write_sweep(tmp_path, "stale", [some_trial(0), some_trial(1, "running")], asked=7)
        (tmp_path / "sweeps" / "torn" / "trials.jsonl").open("a").write('{"number":')
        shutil.copytree(tmp_path / "sweeps" / "fine", tmp_path / "sweeps" / "fine2")
        write_sweep(tmp_path, "going", [])
        lock = FileLock(tmp_path / "sweeps" / "going" / "lock")
        lock.acquire()  # somebody carries it out
        found = {(one.run or "", one.what) for one in check(store, tmp_path)}
        lock.release()
    assert found == {
        ("unknown-20260101-000000", "it has a folder, and is not in the database"),
        ("gone-20260101-000000", "it is in the database, and its folder is gone"),
        ("stale-20260101-000000", "asked is 7 in its folder and 3 in the database"),
        ("stale-20260101-000000", "the trials differ in the database"),
        ("", "a sweep's folder: torn: trials.jsonl:2: the last line is torn; left out"),
        ("", "a sweep's folder: fine2: says that it is the sweep fine-20260101-000000, as fine does; left out"),
    }


def test_reindex_keeps_what_a_run_writes_meanwhile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_reindex_forgets_what_is_gone_and_keeps_what_lies_elsewhere(tmp_path: Path) -> None:
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
