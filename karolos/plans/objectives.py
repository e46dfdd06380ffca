"""The objectives of a sweep, computed from tests as means over the seeds.

Their names stand in `karolos.specification.sweep`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from ..comparison.reaching import first_reaching
from ..evaluation.policies import signature_of
from ..launchers.runs import RunJob
from ..records.evaluation import Evaluation
from ..specification import Spec
from ..specification.sweep import MEASURES, Direction
from ..specification.sweep import directions as directions_of

CENSORED_FACTOR = 2
"""Penalty factor on the steps of a run that never reached the threshold (PAR2)."""
Tests = Mapping[int, Sequence[Evaluation]]
"""Seed -> its tests, in order."""


def directions(spec: Spec) -> tuple[Direction, ...]:
    """maximize or minimize, for each objective of the spec's sweep."""
    assert spec.sweep is not None  # callers see to it
    return directions_of(spec.sweep.objectives, signature_of(spec).measures)


def measure(objective: str, tests: Tests, steps: int, finals: Mapping[int, Evaluation] = MappingProxyType({})) -> float:
    """The objective's value for finished runs of `steps` environment steps; nan without tests.

    `finals` holds, by seed, the policy `last` in the final test of the runs that have one.
    """
    if not tests or not all(tests.values()):
        return float("nan")
    return float(np.mean([_of_run(objective, results, steps, finals.get(seed)) for seed, results in tests.items()]))


def measure_all(objectives: Sequence[str], job: RunJob) -> tuple[float, ...]:
    """The value of each objective for a job's finished runs, as `measure`."""
    results = job.results()
    finals = {seed: final["last"] for seed in results if (final := job.folders[seed].final())}
    return tuple(measure(name, results, job.spec.training.steps, finals) for name in objectives)


def _of_run(objective: str, tests: Sequence[Evaluation], steps: int, final: Evaluation | None) -> float:
    if objective.startswith("steps_to_"):
        threshold = int(objective.removeprefix("steps_to_")) / 100
        reached = first_reaching([test.success_end or 0.0 for test in tests], [test.steps for test in tests], threshold)
        return CENSORED_FACTOR * steps if reached is None else reached
    if objective.startswith("mean_"):
        return float(np.mean([_of_test(objective.removeprefix("mean_"), test) for test in tests]))
    return _of_test(objective, final or tests[-1])


def _of_test(name: str, test: Evaluation) -> float:
    if name.startswith(MEASURES):
        mean = test.measures[name.removeprefix(MEASURES)]["mean"]
        return float("nan") if mean is None else mean
    return test.known_return if name == "return" else float(getattr(test, name) or 0.0)


def so_far(objective: str, tests: Tests, count: int) -> float:
    """The value for the pruner after `count` tests of every seed; it has the direction of the objective.

    steps_to_* are unknown before the end. For them it is the fraction of failed test episodes.
    """
    begun = {seed: results[:count] for seed, results in tests.items()}
    if objective.startswith("steps_to_"):
        return 1 - measure("success_end", begun, 0)
    return measure(objective, begun, 0)


def nominal_steps(steps: int, interval: int, budget: int) -> int:
    """The multiple of the test interval at or below `steps`: tests of different trials differ by up to a round."""
    return budget if steps >= budget else steps // interval * interval
