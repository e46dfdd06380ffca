"""Experiments: one spec and its seeds, each a run; what a run writes down, resumes from and tells its listeners."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .experiment import Experiment, Outcome

__all__ = ["Experiment", "Outcome"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        from . import experiment  # noqa: PLC0415  (loads torch, which events and signals need not)

        return getattr(experiment, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
