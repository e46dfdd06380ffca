from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from karolos.records import RunFolder
from karolos.records.results import TestResult
from karolos.store import Store, reindex

runs_with_tests = st.lists(
    st.tuples(
        st.sampled_from(["finished", "failed", "stopped", "running"]),
        st.sampled_from(["abc", "xyz"]),
        st.lists(st.tuples(st.integers(0, 500), st.integers(0, 4)), max_size=4),
    ),
    max_size=4,
)


def result(steps: int, successes: int) -> TestResult:
    flags = tuple(index < successes for index in range(4))
    return TestResult(steps, steps / 7, flags, flags, (False,) * 4, (-1.5,) * 4, (9,) * 4)


def make_run(store: Store, runs: Path, state: str, experiment: str, tests: list[tuple[int, int]], seed: int = 0) -> str:
    with RunFolder.create(runs, "x", seed) as run:
        run.describe({"name": "x", "agent": {"name": "sac"}}, experiment=experiment, source=runs)
        store.add_run(run.summary(), run.spec(), run.versions())
        for steps, successes in tests:
            run.add_test(result(steps, successes))
            store.add_test(run.id, result(steps, successes))
        run.set_state(state, steps=500, seconds=1.25)
        store.update_run(run.summary())
        return run.id


@given(runs_with_tests)
@settings(max_examples=15, deadline=None)
def test_rebuilt_index_gives_the_same_answers(made: list[tuple[str, str, list[tuple[int, int]]]]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        runs = Path(folder)
        with Store(Store.default_url(runs)) as store:
            ids = [make_run(store, runs, *each) for each in made]
            before = [store.runs(), [store.tests(run) for run in ids], [store.spec(run[1]) for run in made]]
        (runs / "karolos.sqlite").unlink()
        with Store(Store.default_url(runs)) as store:
            for _ in range(2):  # a second time changes nothing
                assert reindex(store, runs).problems == ()
                after = [store.runs(), [store.tests(run) for run in ids], [store.spec(run[1]) for run in made]]
                assert after == before


def test_reindex_forgets_what_is_gone_and_keeps_what_lies_elsewhere(tmp_path: Path) -> None:
    runs, elsewhere = tmp_path / "runs", tmp_path / "elsewhere"
    with Store(Store.default_url(tmp_path)) as store:
        kept, gone, other = (
            make_run(store, place, "finished", "abc", [(1, 2)], seed)
            for seed, place in enumerate((runs, runs, elsewhere))  # ids in different folders could be the same
        )
        shutil.rmtree(runs / gone)
        shutil.rmtree(elsewhere)
        done = reindex(store, runs)
        assert (done.runs, done.forgotten) == (1, 1)
        assert {run.run for run in store.runs()} == {kept, other}
        assert len(store.tests(other)) == 1


def test_reindex_names_what_is_damaged_and_enters_the_rest(tmp_path: Path) -> None:
    with Store(Store.default_url(tmp_path)) as store:
        torn, broken = (make_run(store, tmp_path, "finished", "abc", [(1, 2), (2, 3)]) for _ in range(2))
        store.remove_runs([torn, broken])
        with (tmp_path / torn / "tests.jsonl").open("r+") as file:
            file.truncate(file.seek(0, 2) - 5)
        (tmp_path / broken / "run.json").write_text("{")
        done = reindex(store, tmp_path)
        assert done.runs == 1
        assert [test.steps for test in store.tests(torn)] == [1]
        assert any("tests.jsonl:2: the last line is torn" in problem for problem in done.problems)
        assert any(broken in problem and "run.json is damaged" in problem for problem in done.problems)
