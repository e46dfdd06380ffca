"""What a robot or a task lets domain randomization change."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Parameter:
    """A number of the world that may differ between episodes."""

    unit: str
    nominal: float
    """Its value without randomization."""
    low: float
    high: float
    """Values outside [low, high] make no sense, and are never applied."""
    description: str = ""
