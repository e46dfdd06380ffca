"""Karolos: declarative reinforcement-learning experiments on robot-task environments."""

import sys

__version__ = "0.1.0"

if "gymnasium" in sys.modules:  # whoever uses gymnasium finds the environments there; nobody else pays for it
    from .environments import gymnasium_export  # noqa: F401
