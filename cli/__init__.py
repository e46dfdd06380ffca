"""The command line. A command imports heavy libraries when it is called."""

from karolos.experiment.interrupt import BriefInterrupt

with BriefInterrupt():
    from .main import main

__all__ = ["main"]
