"""Compares experiments by the numbers of their runs, with statistics over seeds. `karolos.report` draws them."""

from .contenders import Contender, gather
from .curves import learning_curve
from .scores import Comparison, Estimate, compare

__all__ = ["Comparison", "Contender", "Estimate", "compare", "gather", "learning_curve"]
