"""Runs a policy, exported by karolos as a bundle, on a robot. It needs only numpy and PyYAML."""

from .bundle import Bundle, BundleError
from .executor import Executor
from .faults import Fault
from .policy import NumpyPolicy
from .readings import Reading, SetPoint

__all__ = ["Bundle", "BundleError", "Executor", "Fault", "NumpyPolicy", "Reading", "SetPoint"]
