"""Success of the scripted experts beside a random policy: whether each robot can solve each task."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product

from ..errors import KarolosError
from ..evaluation.playing import score
from ..evaluation.policies import expert_policy
from ..machine import cores
from ..plugins.inspection import floor, pair
from ..registry import names
from ..simulation.engines import Engine
from .side_by_side import Row

PEER = "random policy"


@dataclass(frozen=True)
class ExpertRow(Row):
    """`value` and `peer_value` are shares of episodes with success at the end; low and high: 95 % Wilson intervals."""

    low: float = 0.0
    high: float = 1.0
    any: float = 0.0
    """Share of the expert's episodes in which the goal was reached at some step."""
    steps: float | None = None
    """Mean step at which the expert first reached the goal."""
    peer_low: float = 0.0
    peer_high: float = 1.0
    episodes: int = 0


@dataclass(frozen=True)
class Case:
    """Names of a robot and a task, the robot's control mode and the engine; None: the default."""

    robot: str
    task: str
    control: str | None = None
    engine: Engine | None = None

    def __str__(self) -> str:
        return " ".join(part for part in (self.robot, self.task, self.control, self.engine) if part)

    @property
    def settings(self) -> dict[str, str]:
        """Of the robot."""
        return {} if self.control is None else {"control": self.control}


def check(case: Case) -> None:
    """Raise UsageError or PluginError where robot and task do not go together."""
    pair(case.robot, case.task, case.engine, **case.settings).close()


def all_cases(control: str | None = None, engine: Engine | None = None) -> tuple[list[Case], list[KarolosError]]:
    """Every robot with every task that goes with it, and why the others do not."""
    cases, refusals = [], []
    for robot, task in product(names("robots"), names("tasks")):
        case = Case(robot, task, control, engine)
        try:
            check(case)
        except KarolosError as error:
            refusals.append(error)
        else:
            cases.append(case)
    return cases, refusals


def measure(cases: Sequence[Case], *, episodes: int, seed: int = 0, jobs: int | None = None) -> Iterator[ExpertRow]:
    """One row per case, in their order, as soon as it is known.

    Expert and random policy play the same test episodes, which the root `seed` determines.

    Args:
        cases: pairs to measure.
        episodes: of each policy.
        seed: root of the episodes' seeds.
        jobs: processes, each measuring one case at a time; by default one per core.

    Raises:
        UsageError: a robot or task is unknown, or the task has no expert.
        PluginError: robot and task do not go together.
    """
    work = [(case, episodes, seed) for case in cases]
    processes = min(jobs or cores(), len(work))
    if processes < 2:
        yield from map(_row, work)
        return
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        try:
            yield from pool.map(_row, work)
        finally:
            pool.shutdown(cancel_futures=True)


def _row(work: tuple[Case, int, int]) -> ExpertRow:
    case, episodes, seed = work
    environment = pair(case.robot, case.task, case.engine, **case.settings)
    try:
        expert = score(environment, expert_policy(environment), episodes=episodes, seed=seed)
    finally:
        environment.close()
    random = floor(case.robot, case.task, case.engine, episodes=episodes, seed=seed, **case.settings)
    return ExpertRow(
        benchmark="experts",
        case=str(case),
        value=expert.success_end,
        unit="success at the end",
        peer=PEER,
        peer_value=random.success_end,
        low=expert.low,
        high=expert.high,
        any=expert.success_any,
        steps=expert.steps,
        peer_low=random.low,
        peer_high=random.high,
        episodes=episodes,
    )
