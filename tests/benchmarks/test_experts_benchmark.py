from __future__ import annotations

import numpy as np
import pytest

from karolos.benchmarks.experts import Case, all_cases, measure
from karolos.core import random_actions
from karolos.core.seeding import SeedTree
from karolos.environments.robot_task import RobotTask
from karolos.evaluation.testing import test_seeds as episode_seeds
from karolos.plugins.inspection import pair
from karolos.registry import names

EPISODES, SEED = 60, 0
"""In one of these episodes the Panda's expert misses."""


def successes(environment: RobotTask, *, expert: bool) -> list[list[bool]]:
    """Success at every step of the test episodes, played here step by step."""
    generator = SeedTree(SEED).child("random policy").generator()
    episodes = []
    for seed in episode_seeds(SEED, EPISODES):
        step = environment.reset(seed)
        script = environment.expert() if expert else None
        if script is not None:
            script.reset()
        flags = []
        while not (step.terminated or step.truncated):
            action = random_actions(environment.signature, 1, generator)[0] if script is None else script.act()
            step = environment.step(np.asarray(action, np.float32))
            flags.append(bool(step.success))
        episodes.append(flags)
    return episodes


def test_rows_count_the_successes_of_episodes_that_are_played_by_hand() -> None:
    (row,) = measure([Case("panda", "push")], episodes=EPISODES, seed=SEED)
    environment = pair("panda", "push")
    by_expert, by_chance = successes(environment, expert=True), successes(environment, expert=False)
    environment.close()
    assert row.value == np.mean([flags[-1] for flags in by_expert])
    assert row.any == np.mean([any(flags) for flags in by_expert])
    assert row.steps == pytest.approx(np.mean([flags.index(True) + 1 for flags in by_expert if any(flags)]))
    assert row.peer_value == np.mean([flags[-1] for flags in by_chance])
    assert 0 < row.low < row.value < 1, "a figure that could not be anything else shows nothing"
    assert row.episodes == EPISODES


def test_figures_are_the_same_with_one_process_and_with_two() -> None:
    cases = [Case("panda", "reach"), Case("iiwa", "push", "joint")]
    assert list(measure(cases, episodes=3, jobs=1)) == list(measure(cases, episodes=3, jobs=2))


def test_all_pairs_that_go_together_are_measured() -> None:
    cases, refusals = all_cases()
    assert len(cases) + len(refusals) == len(names("robots")) * len(names("tasks"))
    assert {(case.robot, case.task) for case in cases} >= {(robot, "pick_place") for robot in names("robots")}
