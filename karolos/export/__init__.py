"""Policies for use without karolos: a file for numpy alone, and ONNX."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .numpy_policy import NumpyPolicy

if TYPE_CHECKING:
    from .export import Exported, export_policy

__all__ = ["Exported", "NumpyPolicy", "export_policy"]


def __getattr__(name: str) -> Any:
    if name in ("Exported", "export_policy"):
        from . import export  # noqa: PLC0415  (loads torch)

        return getattr(export, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
