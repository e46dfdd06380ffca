"""The command line of karolos. Heavy libraries are imported by the command that needs them, when it is called."""

from .main import main

__all__ = ["main"]
