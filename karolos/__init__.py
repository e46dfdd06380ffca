"""Karolos: declarative reinforcement-learning experiments on robot-task environments."""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False
"""As `typing` has it. Ctrl-C prints a traceback until commands handle it, and importing `typing` would delay that."""
if TYPE_CHECKING:
    from typing import Any

    from .evaluation.policies import load_run as load
    from .evaluation.policies import make
    from .launchers.experiment import Experiment
    from .store.query import runs

__version__ = "0.3.0"
__all__ = ["Experiment", "load", "make", "runs"]

_LAZY = {
    "Experiment": ("launchers.experiment", "Experiment"),
    "load": ("evaluation.policies", "load_run"),
    "make": ("evaluation.policies", "make"),
    "runs": ("store.query", "runs"),
}
"""Importing karolos takes milliseconds; these import torch, gymnasium or sqlalchemy at their first use."""


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = _LAZY[name]
    return getattr(import_module(f"{__name__}.{module}"), attribute)
