"""Comparison of nested states: of agents, buffers, training, checkpoints."""

from __future__ import annotations

from karolos import checkpoint
from karolos.plugins.contracts.case import state_differences
from karolos.records import RunFolder


def assert_same_state(one: object, other: object) -> None:
    """Assert that two states are equal bit for bit, except the seconds that training took."""
    assert state_differences(one, other, ignore=frozenset({"seconds"})) == []


def assert_same_runs(one: RunFolder, other: RunFolder) -> None:
    """Both runs are finished, and have the same tests, training episodes and checkpoint `last`, bit for bit."""
    assert_same_state(checkpoint.load(one.checkpoints, "last")[0], checkpoint.load(other.checkpoints, "last")[0])
    for first, second in zip(one.tests(), other.tests(), strict=True):
        assert (first.steps, first.any, first.end, first.returns) == (
            second.steps,
            second.any,
            second.end,
            second.returns,
        )
    assert (one.path / "episodes.jsonl").read_text() == (other.path / "episodes.jsonl").read_text()
    assert one.state().state == other.state().state == "finished"
