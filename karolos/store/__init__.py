"""The results database: an index over the run folders, which can rebuild it."""

from .check import Difference, check
from .reindex import Reindexed, reindex
from .store import Store

__all__ = ["Difference", "Reindexed", "Store", "check", "reindex"]
