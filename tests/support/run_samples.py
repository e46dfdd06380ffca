"""Spec and folders of small runs, and what the index has of them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from karolos.records import RunFolder
from karolos.records.evaluation import Evaluation
from karolos.records.run_records import RunRecord, RunSummary
from karolos.store import Store, query

SPEC = {"name": "reach", "environment": {"name": "toy"}, "robot": None, "agent": {"name": "sac"}, "seeds": [3]}


def result(
    steps: int, successes: int, episodes: int = 20, *, end: int | None = None, value: float = -1.5, **others: Any
) -> Evaluation:
    """A test whose first episodes succeed at some step. As many succeed at the end, the last ones, or the first `end`.

    Every return is `value`.
    """
    flags = tuple(index < successes for index in range(episodes))
    ends = flags[::-1] if end is None else tuple(index < end for index in range(episodes))
    usual = {"any": flags, "end": ends, "reset": (False,) * episodes, "returns": (value,) * episodes}
    return Evaluation.of(steps, steps / 100, **usual | {"lengths": (9,) * episodes} | others)


def new_run(
    runs: Path, name: str = "reach", seed: int = 3, *, spec: dict[str, Any] = SPEC, experiment: str = "abc", **more: Any
) -> RunFolder:
    folder = RunFolder.create(runs, name, seed)
    folder.describe(spec, experiment=experiment, **more)
    return folder


def indexed_run(store: Store, runs: Path, name: str = "reach", seed: int = 3) -> RunFolder:
    """The same, in the index."""
    run = new_run(runs, name, seed)
    store.add_records([run.record()])
    return run


def add_run(
    runs: Path,
    seed: int,
    successes: Sequence[int] = (19,),
    *,
    name: str = "reach",
    rate: float = 0.001,
    experiment: str | None = None,
    spec: dict[str, Any] | None = None,
    state: Any = "finished",
    error: str | None = None,
    text: str | None = None,
    **measured: Any,
) -> str:
    """A run of a test every 1000 steps, in the folder's index; returns its id.

    The first word of its name tells its experiment. `measured` is what each test has besides.
    """
    usual = {"name": name, "task": {"name": "reach"}, "agent": {"name": "sac", "learning_rate": rate}}
    experiment = experiment or name.partition("-")[0].encode().hex().ljust(64, "0")
    with RunFolder.create(runs, name, seed) as run, Store(Store.default_url(runs)) as store:
        run.describe(spec or usual, experiment=experiment, text=text, source=runs)
        for place, count in enumerate(successes, 1):
            run.add_test(result(1000 * place, count, **measured))
        run.set_state(state, steps=1000 * len(successes), seconds=10.0 * len(successes), error=error)
        store.add_records([run.record()])
        return run.id


def stored(store: Store, run: str) -> RunRecord:
    """What the index has of a run."""
    (record,) = store.records([query.find(store, run)])
    return record


def summary(**values: Any) -> RunSummary:
    """A finished run that has no folder any more."""
    unknown = ("success_any", "success_end", "steps_to_95", "seconds_to_95", "episodes")
    unknown += ("environment", "robot", "task", "agent", "error")
    usual = {"run": "x", "experiment": "abc", "seed": 0, "state": "finished", "steps": 0, "seconds": 0.0, "name": "x"}
    usual |= dict.fromkeys(("created", "updated"), "2026-01-01T00:00:00.000000Z") | {
        "attempt": 1,
        "folder": "/nowhere/x",
    }
    return RunSummary(**dict.fromkeys(unknown) | usual | values)


def bare(store: Store, run: str, **values: Any) -> RunSummary:
    """The same in the index."""
    found = summary(run=run, **values)
    store.add_records([RunRecord(found, SPEC, (), {})])
    return found
