"""Computes the numbers that compare experiments from their runs. `karolos.report` draws them."""

from .contenders import Contender, gather
from .curves import learning_curve
from .scores import Comparison, Estimate, compare

__all__ = ["Comparison", "Contender", "Estimate", "compare", "gather", "learning_curve"]
