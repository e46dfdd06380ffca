"""Comparison of nested states: of agents, buffers, training, checkpoints."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from karolos.plugins.contracts.case import state_differences
from karolos.records import RunFolder, checkpoint


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
