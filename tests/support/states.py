"""Comparison of nested states: of agents, buffers, training, checkpoints."""

from __future__ import annotations

from karolos.plugins.contracts.case import state_differences


def assert_same_state(one: object, other: object) -> None:
    """Assert that two states are equal bit for bit, except the seconds that training took."""
    assert state_differences(one, other, ignore=frozenset({"seconds"})) == []
