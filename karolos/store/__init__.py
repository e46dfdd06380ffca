"""The results database: an index over the run folders, which can rebuild it."""

from .folders import Difference, Reindexed, check, reindex
from .store import Store

__all__ = ["Difference", "Reindexed", "Store", "check", "reindex"]
