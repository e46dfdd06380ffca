"""Karolos: declarative reinforcement-learning experiments on robot-task environments."""

__version__ = "0.1.0"
