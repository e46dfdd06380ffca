"""The results database: an index over the run folders, which can rebuild it."""

from .reindex import Reindexed, reindex
from .store import Store, StoredTest

__all__ = ["Reindexed", "Store", "StoredTest", "reindex"]
