"""Karolos: declarative reinforcement-learning experiments on robot-task environments."""

from .environments.gymnasium_hook import register_with_gymnasium

__version__ = "0.1.0"

register_with_gymnasium()
