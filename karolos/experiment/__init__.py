"""An experiment is one spec and its seeds. Each seed is a run, which is written down and can be resumed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .experiment import Experiment, Outcome

__all__ = ["Experiment", "Outcome"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        from . import experiment  # noqa: PLC0415  (imports torch, which events and signals do not need)

        return getattr(experiment, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
