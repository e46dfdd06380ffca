"""Policies for use without karolos: a file that needs only numpy, ONNX, and bundles for robots."""

from karolos_deploy.policy import NumpyPolicy

__all__ = ["NumpyPolicy"]
