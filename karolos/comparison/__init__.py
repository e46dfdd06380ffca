"""From runs to the numbers that compare experiments. `karolos.report` draws them."""

from .conditions import conditions
from .contenders import (
    ComparedRun,
    Contender,
    Metric,
    Success,
    averaged,
    gather,
    labels_of,
    name_of,
    one_per_seed,
    repeated,
)
from .curves import Curve, densities, learning_curve
from .differences import MISSING, differences
from .scores import Comparison, Estimate, Reaching, Scores, compare

__all__ = [
    "MISSING",
    "ComparedRun",
    "Comparison",
    "Contender",
    "Curve",
    "Estimate",
    "Metric",
    "Reaching",
    "Scores",
    "Success",
    "averaged",
    "compare",
    "conditions",
    "densities",
    "differences",
    "gather",
    "labels_of",
    "learning_curve",
    "name_of",
    "one_per_seed",
    "repeated",
]
