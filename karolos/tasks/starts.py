"""Starts by stages: training episodes that begin further on, such as with the object in the hand. Tests never do.

A task declares a probability for each stage, `start_<stage>`, and asks at a reset which one the episode begins in.
"""

from __future__ import annotations

from typing import Any

from pydantic import Field as Setting

from ..core import Settings


def start(how: str) -> Any:
    """The setting of a stage, of the type `Probability`."""
    return Setting(0.0, description=f"probability that an episode starts with {how}, of those without an earlier stage")


def drawn_stage(drawn: Settings, draw: float, *stages: str) -> str | None:
    """The stage that an episode begins in, or None.

    Args:
        drawn: the task's settings of the episode.
        draw: uniform in [0, 1).
        stages: in their order: the probability of each is that of the episodes that those before it leave.
    """
    taken = 0.0
    for stage in stages:
        taken += (1 - taken) * getattr(drawn, f"start_{stage}")
        if draw < taken:
            return stage
    return None
