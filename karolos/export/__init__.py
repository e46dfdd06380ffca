"""Policies for use without karolos: a file for numpy alone, ONNX, and bundles for robots."""

from karolos_deploy.policy import NumpyPolicy

__all__ = ["NumpyPolicy"]
