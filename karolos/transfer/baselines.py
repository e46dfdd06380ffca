"""What is possible on a variant without learning: random actions and the task's expert."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..core import Environment
from ..environments.build import opened
from ..errors import UsageError
from ..evaluation.playing import evaluate
from ..evaluation.policies import Policy, expert_policy, random_policy
from ..experiment.signals import StopRequest
from ..files import append_lines, read_lines
from ..records.decode import from_json
from ..records.evaluation import Evaluation
from ..specification import Spec

BASELINE_EPISODES = 200
"""Most episodes of the random policy and of the expert: the first ones of the final test."""


@dataclass(frozen=True)
class Baselines:
    """Success on a variant without learning."""

    floor: Evaluation
    """Of uniformly random actions."""
    ceiling: Evaluation | None
    """Of the task's scripted expert; None without one."""


def measure_baselines(spec: Spec, path: Path, stop: StopRequest) -> Baselines:
    """Success of random actions and of the expert, from the file if they were measured already."""
    episodes = min(spec.testing.final_count or spec.testing.episodes, BASELINE_EPISODES)
    key = {"experiment": spec.hash(), "episodes": episodes}
    for row in read_lines(path).rows:
        if key.items() <= row.items() and (known := from_json(Baselines, row)) is not None:
            return known
    floor = _evaluate(spec, random_policy, episodes, stop)
    try:
        ceiling = _evaluate(spec, lambda environment, _: expert_policy(environment), episodes, stop)
    except UsageError:  # there is no expert
        ceiling = None
    append_lines(path, [key | {"floor": floor.encode(), "ceiling": ceiling and ceiling.encode()}])
    return Baselines(floor, ceiling)


def _evaluate(spec: Spec, make: Callable[[Environment, int], Policy], episodes: int, stop: StopRequest) -> Evaluation:
    """Success of a policy on the first episodes of the final test. Raises StopRequestedError."""
    seed = spec.testing.final_seed
    with opened(spec.recipe(randomize=False)) as environment:
        policy = make(environment, seed)

        def begin() -> None:
            stop.check()
            policy.begin()

        return evaluate(environment, Policy(policy.act, begin), episodes=episodes, seed=seed).counts
