"""What the store knows beside runs and tests, and how it is asked."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import select, update
from support.databases import KINDS, empty_database
from support.run_samples import bare

from karolos.errors import StoreError, UsageError
from karolos.records import RunFolder, labels
from karolos.statistics.density import kde
from karolos.store import Store
from karolos.store.summaries import success_densities
from karolos.store.tables import SUCCESSES


@pytest.fixture(params=KINDS)
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Store]:
    with empty_database(request.param, tmp_path) as url, Store(url) as found:
        yield found


def add(store: Store, runs: Path, seed: int, rate: float = 0.001, experiment: str = "a" * 64) -> RunFolder:
    with RunFolder.create(runs, f"exp-{experiment[0]}", seed) as run:
        spec = {
            "name": "x",
            "task": {"name": "reach"},
            "agent": {"name": "sac", "learning_rate": rate, "hidden": [8, 8]},
        }
        run.describe(spec, experiment=experiment, source=runs)
        run.set_state("finished", steps=100 * seed)
        store.add_records([run.record()])
        return run


def seeds(store: Store, where: str) -> list[int]:
    return sorted(run.seed for run in store.runs(where=where))


def test_filters_know_columns_settings_labels_and_versions(store: Store, tmp_path: Path) -> None:
    first, second, third = add(store, tmp_path, 1), add(store, tmp_path, 2, 1e-4), add(store, tmp_path, 3, 1e-4)
    labels.add_tags(first.path, ["good", "to show"])
    labels.set_note(second.path, 'fell "over"')
    before = store.database.version()
    assert store.runs()
    assert store.database.version() == before
    for run in (first, second):
        store.refresh_labels(run)
    assert store.database.version() != before, "a reader notices"
    third.set_state("running")  # and nobody runs it
    store.add_records([third.record()])
    assert seeds(store, "task=reach and agent.learning_rate<1e-3") == [2, 3]
    assert seeds(store, "agent.learning_rate<1e-3 and state=finished") == [2]
    assert seeds(store, "state=lost") == [3]
    assert seeds(store, "tags=good") == seeds(store, "tags ~ SHOW") == [1]
    assert seeds(store, "tags != good") == [2, 3]
    assert seeds(store, "note ~ over") == seeds(store, """note = 'fell "over"'""") == [2]
    assert seeds(store, "note = null") == [1, 3]
    assert seeds(store, "agent.hidden = '[8, 8]' and seed >= 2") == [2, 3]
    assert seeds(store, "steps in (100, 300) or seed = 2") == [1, 2, 3]
    assert seeds(store, f"versions.karolos = {first.record().versions['karolos']}") == [1, 2, 3]
    assert seeds(store, f"folder = '{first.path}'") == [1]
    assert seeds(store, "created > 2020-01-01") == [1, 2, 3]
    assert [run.seed for run in store.runs(where="task=reach", limit=2)] == [3, 2]
    assert store.runs(where="tags=good") == (first.summary(),)


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
def test_a_filter_that_can_match_no_run_says_why(store: Store, tmp_path: Path, where: str, told: str) -> None:
    add(store, tmp_path, 1)
    with pytest.raises(UsageError) as caught:
        store.runs(where=where)
    assert told in str(caught.value)


def test_selector_means_a_run_or_all_of_an_experiment(store: Store, tmp_path: Path) -> None:
    ab, ac = "ab" * 32, "abac" * 16
    runs = [add(store, tmp_path, seed, experiment=ab if seed < 3 else ac) for seed in (1, 2, 3)]
    first, second, third = (run.summary() for run in runs)
    assert store.select("exp-a") == (third, second, first)
    assert store.select("ababab") == (second, first)
    assert store.select("abacab") == (third,)
    assert store.select("@last-1") == (second,)
    assert store.select(first.run) == (first,)
    assert store.select(first.run[:8]) == (first,)
    assert store.find("abacab") == third
    with pytest.raises(UsageError, match="'ababab' means several runs"):
        store.find("ababab")
    with pytest.raises(UsageError, match=r"'@last-3' means no run; there are 3, from @last on"):
        store.select("@last-3")
    with pytest.raises(UsageError, match="'exp-' means several runs"):
        store.select("exp-")
    with pytest.raises(UsageError, match="'ffffff' means no run"):
        store.select("ffffff")


def test_hash_that_begins_several_experiments_names_them(store: Store) -> None:
    for tail in "12":
        bare(store, f"run{tail}", experiment="abcdef" + tail * 58)
    with pytest.raises(UsageError, match="'abcdef' begins several experiments; add digits: abcdef111111, abcdef222222"):
        store.select("abcdef")


def stored_densities(store: Store) -> list[tuple[float, int, float]]:
    rows = store.database.fetch(select(SUCCESSES).order_by(SUCCESSES.c.steps))
    return [(row.steps, row.runs, row.mode) for row in rows]


def test_densities_are_stored_until_a_test_or_a_run_is_added_or_removed(store: Store, tmp_path: Path) -> None:
    runs = [add(store, tmp_path, seed) for seed in (1, 2, 3)]
    ratios = {100.0: [1.0, 0.9, 0.2], 200.5: [0.5, 0.5, 0.5]}
    first = success_densities(store, "a" * 64, "end", ratios)
    for density, values in zip(first, ratios.values(), strict=True):
        for name, value in vars(kde(values)).items():
            assert np.array_equal(getattr(density, name), value)
    assert stored_densities(store) == [(100.0, 3, first[0].mode), (200.5, 3, 0.5)]
    with store.database.writing() as connection:
        connection.execute(update(SUCCESSES).values(mode=0.125))
    again = success_densities(store, "a" * 64, "end", ratios)
    assert [one.mode for one in again] == [0.125, 0.125], "read, not computed"
    assert np.array_equal(again[0].density, first[0].density)
    [other] = success_densities(store, "a" * 64, "end", {100.0: [1.0, 0.9, 0.3]})
    assert other.mode == kde([1.0, 0.9, 0.3]).mode, "of other ratios"
    for change in (
        lambda: store.remove_runs([runs[0].id]),
        lambda: store.add_records([runs[0].record()]),
    ):
        success_densities(store, "a" * 64, "any", ratios)
        change()
        assert stored_densities(store) == []


def test_database_that_may_only_be_read_still_answers(tmp_path: Path) -> None:
    with Store(Store.default_url(tmp_path)) as store:
        run = add(store, tmp_path, 1)

        def read_only(connection: sqlite3.Connection, _: object) -> None:
            connection.execute("PRAGMA query_only = ON")

        from sqlalchemy import event

        event.listen(store.database.engine, "connect", read_only)
        assert [one.mode for one in success_densities(store, "a" * 64, "end", {100: [1.0]})] == [1.0]
        assert store.runs(where="task=reach") == (run.summary(),)
        with pytest.raises(StoreError, match="the database is read-only"):
            store.add_records([run.record()])
