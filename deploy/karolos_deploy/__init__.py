"""Runs a policy that karolos exported as a bundle on a robot. It needs numpy and PyYAML only."""

from .bundle import Bundle, BundleError
from .executor import Executor
from .faults import Fault
from .policy import NumpyPolicy
from .readings import Reading, SetPoint

__all__ = ["Bundle", "BundleError", "Executor", "Fault", "NumpyPolicy", "Reading", "SetPoint"]
