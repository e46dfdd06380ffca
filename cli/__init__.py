"""The command line. A command imports heavy libraries when it is called."""

from .main import main

__all__ = ["main"]
