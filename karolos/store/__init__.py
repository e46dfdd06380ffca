"""The results database: an index over the run folders, which can rebuild it."""

from .folders import Difference, Reindexed, check, open_index, reindex
from .store import Store

__all__ = ["Difference", "Reindexed", "Store", "check", "open_index", "reindex"]
