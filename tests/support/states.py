"""Comparison of nested states: of agents, buffers, training, checkpoints."""

from typing import Any

import numpy as np
import torch

from karolos.plugins.contracts.case import state_differences
from karolos.records import RunFolder, checkpoint
from karolos.store import Store, query


def assert_same_state(one: object, other: object) -> None:
    """Assert that two states are equal bit for bit, except the seconds that training took."""
    assert state_differences(one, other, ignore=frozenset({"seconds"})) == []


def run_differences(one: RunFolder, other: RunFolder, database: str | None = None) -> list[str]:
    """Where two runs of the same spec and seed differ, except for the seconds they took.

    Args:
        one: folder of a run.
        other: folder of another one.
        database: URL of the index that holds the first.
    """
    last, reference = (checkpoint.load(run.checkpoints, "last")[0] for run in (one, other))
    found = state_differences(last, reference, ignore=frozenset({"seconds"}), path="last")
    tests, expected = ([(test.steps, test.any, test.end, test.returns) for test in run.tests()] for run in (one, other))
    found += ["tests.jsonl"] if tests != expected else []
    if (one.path / "episodes.jsonl").read_text() != (other.path / "episodes.jsonl").read_text():
        found.append("episodes.jsonl")
    if database is not None:
        with Store(database) as store:
            (record,) = store.records([query.find(store, one.id)])
        counts = [(test.steps, test.successes_any, test.successes_end) for test in record.tests]
        if counts != [(test.steps, sum(test.any), sum(test.end)) for test in one.tests()]:
            found.append(f"tests in the database: {counts}")
        if record.summary != one.summary():
            found.append("the run's row in the database")
    return found


def assert_same_runs(one: RunFolder, other: RunFolder) -> None:
    """Both runs are finished, and have the same tests, training episodes and checkpoint `last`, bit for bit."""
    assert run_differences(one, other) == []
    assert one.state().state == other.state().state == "finished"


def raw(tensor: torch.Tensor) -> torch.Tensor:
    """The bytes of a tensor."""
    return tensor.reshape(-1).view(torch.uint8)


def same(ours: Any, theirs: Any) -> bool:
    """Equal bit for bit, types included."""
    if isinstance(ours, torch.Tensor):
        return ours.dtype == theirs.dtype and torch.equal(raw(ours), raw(theirs))
    if isinstance(ours, np.ndarray | np.generic):
        layout = (type(ours), ours.dtype, ours.shape) == (type(theirs), theirs.dtype, theirs.shape)
        return layout and ours.tobytes() == theirs.tobytes()
    if isinstance(ours, dict):
        return list(ours) == list(theirs) and all(same(ours[key], theirs[key]) for key in ours)
    if isinstance(ours, list | tuple):
        return type(ours) is type(theirs) and len(ours) == len(theirs) and all(map(same, ours, theirs))
    return type(ours) is type(theirs) and repr(ours) == repr(theirs)
