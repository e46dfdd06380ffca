"""How often the scripted experts succeed, beside a random policy: whether each pair of robot and task can be solved."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product

from ..errors import KarolosError
from ..evaluation.playing import expert_policy
from ..evaluation.scoring import Score, score
from ..plugins.inspection import floor, pair
from ..registry import names
from .row import Row

PEER = "random policy"


@dataclass(frozen=True)
class ExpertRow(Row):
    """`value` and `peer_value` are success at the end of an episode, with 95 % Wilson intervals."""

    low: float = 0.0
    high: float = 1.0
    any: float = 0.0
    """Share of the expert's episodes in which the goal was reached at some step."""
    steps: float | None = None
    """Mean step at which the expert first reached it."""
    peer_low: float = 0.0
    peer_high: float = 1.0
    episodes: int = 0


@dataclass(frozen=True)
class Case:
    """A robot with a task, by name; `control` None: as the robot has it by default."""

    robot: str
    task: str
    control: str | None = None

    def __str__(self) -> str:
        return " ".join(part for part in (self.robot, self.task, self.control) if part)

    @property
    def settings(self) -> dict[str, str]:
        """Of the robot."""
        return {} if self.control is None else {"control": self.control}


def check(case: Case) -> None:
    """Raises UsageError or PluginError where the two do not go together."""
    pair(case.robot, case.task, **case.settings).close()


def all_cases(control: str | None = None) -> tuple[list[Case], list[KarolosError]]:
    """Every robot with every task that goes with it, and why the others do not."""
    cases, refusals = [], []
    for robot, task in product(names("robots"), names("tasks")):
        case = Case(robot, task, control)
        try:
            check(case)
        except KarolosError as error:
            refusals.append(error)
        else:
            cases.append(case)
    return cases, refusals


def measure(cases: Sequence[Case], *, episodes: int, seed: int = 0, jobs: int | None = None) -> Iterator[ExpertRow]:
    """One row per case, in their order, as soon as it is known.

    Expert and random policy play the same test episodes under the root `seed`; what comes out depends on nothing else.

    Args:
        jobs: processes, each measuring one case at a time; one per core unless told otherwise.

    Raises UsageError or PluginError for a pair that does not go together, or has no expert.
    """
    work = [(case, episodes, seed) for case in cases]
    processes = min(jobs or _cores(), len(work))
    if processes < 2:
        yield from map(_row, work)
        return
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        try:
            yield from pool.map(_row, work)
        finally:
            pool.shutdown(cancel_futures=True)


def _cores() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _row(work: tuple[Case, int, int]) -> ExpertRow:
    case, episodes, seed = work
    expert = _expert(case, episodes, seed)
    random = floor(case.robot, case.task, episodes=episodes, seed=seed, **case.settings)
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


def _expert(case: Case, episodes: int, seed: int) -> Score:
    environment = pair(case.robot, case.task, **case.settings)
    try:
        return score(environment, expert_policy(environment), episodes=episodes, seed=seed)
    finally:
        environment.close()
