"""Success of the scripted experts and of a random policy, for each robot with each task."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from functools import partial
from itertools import product
from statistics import fmean
from typing import Annotated

from typer import Option

from karolos.errors import KarolosError, UsageError
from karolos.evaluation.playing import FirstSuccesses, evaluate
from karolos.evaluation.policies import expert_policy, random_policy
from karolos.evaluation.testing import playing_processes
from karolos.gym import STEPS
from karolos.plugins import inspection
from karolos.records.intervals import wilson
from karolos.registry import names
from karolos.simulation.engines import Engine
from karolos.simulation.interface import Task
from karolos.system import cores

from .side_by_side import Row


def measure(
    *,
    pair: Annotated[list[str] | None, Option(metavar="ROBOT/TASK")] = None,
    episodes: Annotated[int, Option(min=1)] = 200,
    engine: Engine | None = None,
    seed: Annotated[int, Option(min=0)] = 0,
    steps: Annotated[int | None, Option(min=1)] = None,
    jobs: Annotated[int, Option(min=1)] = cores(),
) -> Iterator[Row]:
    """Success at the end per pair, in their order, as soon as it is known. Both policies play the same test episodes.

    More columns: `low` and `high` (95 % Wilson intervals), `peer_low`, `peer_high`, `any` (success at some step),
    `steps` (mean step at which the goal was first reached), `episodes`.

    Args:
        pair: ROBOT/TASK; by default all that go together. Why the others do not is said.
        episodes: of each policy.
        seed: root of the episodes' seeds.
        steps: of an episode; by default those of the pair's newest id in gymnasium.
        jobs: processes, each measuring one pair at a time.
    """
    cases = []
    named = [text.partition("/")[::2] for text in pair or ()]
    for robot, task in named or product(names("robots"), names("tasks")):
        try:
            made = inspection.pair(robot, task, engine)
            made.close()
            if type(made.task).expert is Task.expert:
                raise UsageError(f"{task} has no expert")
        except KarolosError as error:
            if named:
                raise
            print(f"left out: {error}", file=sys.stderr)
        else:
            cases.append((robot, task))
    with playing_processes(min(jobs, len(cases))) as pool:
        yield from pool.map(partial(_row, engine, episodes, seed, steps), cases)


def _row(engine: Engine | None, episodes: int, seed: int, steps: int | None, case: tuple[str, str]) -> Row:
    environment = inspection.pair(*case, engine, steps=steps or STEPS.get(case[1]))
    first = FirstSuccesses()
    expert = evaluate(environment, expert_policy(environment), episodes=episodes, seed=seed, heard=first)
    random = evaluate(environment, random_policy(environment, seed), episodes=episodes, seed=seed)
    environment.close()
    (low, high), (peer_low, peer_high) = (wilson(sum(one.end), episodes) for one in (expert, random))
    more = {
        "low": low,
        "high": high,
        "any": expert.success_any,
        "steps": first.mean,
        "peer_low": peer_low,
        "peer_high": peer_high,
    }
    what = " ".join(filter(None, (*case, engine)))
    value, floor = fmean(expert.end), fmean(random.end)
    return Row(what, value, "success at the end", "random policy", floor, more=more | {"episodes": episodes})
