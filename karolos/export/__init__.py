"""Policies for use without karolos: a file for numpy alone, and ONNX."""

from .numpy_policy import NumpyPolicy

__all__ = ["NumpyPolicy"]
