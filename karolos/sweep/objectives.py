"""What a trial is judged by: numbers of its runs' tests, means over the seeds. Names as in karolos.spec.sweep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from ..records.results import TestResult
from ..spec.sweep import OBJECTIVES
from ..statistics.aggregates import first_reaching

CENSORED = 2
"""A run that never reached the threshold counts as having taken this many times its steps (PAR2)."""
Tests = Mapping[int, Sequence[TestResult]]
"""Seed -> its tests, in order."""


def directions(objectives: Sequence[str]) -> tuple[Literal["maximize", "minimize"], ...]:
    """maximize or minimize, for each objective."""
    return tuple(OBJECTIVES[name] for name in objectives)


def measure(objective: str, tests: Tests, steps: int) -> float:
    """The objective's value for runs of `steps` environment steps that are finished; nan where there is no test."""
    if not tests or not all(tests.values()):
        return float("nan")
    return float(np.mean([_of_run(objective, results, steps) for results in tests.values()]))


def _of_run(objective: str, tests: Sequence[TestResult], steps: int) -> float:
    if objective.startswith("steps_to_"):
        threshold = int(objective.removeprefix("steps_to_")) / 100
        reached = first_reaching([test.success_any for test in tests], [test.steps for test in tests], threshold)
        return CENSORED * steps if reached is None else reached
    if objective.startswith("mean_"):
        return float(np.mean([_of_test(objective.removeprefix("mean_"), test) for test in tests]))
    return _of_test(objective, tests[-1])


def _of_test(name: str, test: TestResult) -> float:
    return float(np.mean(test.returns)) if name == "return" else float(getattr(test, name))


def so_far(objective: str, tests: Tests, count: int) -> float:
    """What the pruner compares after `count` tests of every seed; better in the same direction as the objective.

    For steps_to_*, which are not known yet, the share of test episodes that fail.
    """
    begun = {seed: results[:count] for seed, results in tests.items()}
    if objective.startswith("steps_to_"):
        return 1 - measure("success_any", begun, 0)
    return measure(objective, begun, 0)


def nominal_steps(steps: int, interval: int, budget: int) -> int:
    """The multiple of the interval that a test after so many steps stands for: trials differ by a round at most."""
    return budget if steps >= budget else steps // interval * interval
