"""Trials of single settings on each task, which tell which of them matter: docs/settings.md has their table.

python docs/_scripts/trials.py   print the commands of the trials that runs/reference does not hold
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from statistics import fmean

import numpy as np

from karolos.comparison import Contender
from karolos.comparison.aggregates import LEVELS, RESAMPLES, improvement
from karolos.core.seeding import SeedTree
from karolos.errors import UsageError
from karolos.experiment.check import check_parts
from karolos.records.run_records import RunRecord
from karolos.specification import Spec, load_spec

ROOT = Path(__file__).parents[2]
SEEDS = 2
"""Of each trial; reaching, which takes seconds, has five."""
STEPS = {
    "reach": 2_000,
    "push": 30_000,
    "pick": 30_000,
}
"""Task, as in the name of a spec -> the steps of a trial: where the shipped spec has learned, or nearly."""
TRIALS: dict[str, tuple[str, ...]] = {
    "uniform": ("buffer.name=uniform",),
    "priority": ("buffer.name=priority",),
    "no_next": ("buffer.hindsight.next_share=0",),
    "next": ("buffer.hindsight.next_share=0.4",),
    "self_imitation": ("agent.imitation=1", "buffer.hindsight.imitate=true"),
    "no_self_imitation": ("agent.imitation=0", "buffer.hindsight.imitate=false"),
    "random": ("agent.random_actions=0.1",),
    "not_random": ("agent.random_actions=0",),
    "discount": ("agent.discount=0.98",),
    "n_step": ("buffer.n_step=3",),
    "updates": ("training.batch_size=128",),  # replay_ratio counts samples
    "learning_rate": ("agent.learning_rate=1e-3",),
    "slow_targets": ("agent.tau=0.05",),
    "wide": ("agent.hidden=[256,256]",),
    "three_layers": ("agent.hidden=[128,128,128]",),
    "no_layer_norm": ("agent.layer_norm=false",),
    "quantiles": ("agent.critic={quantiles: 25}",),
    "policy_delay": ("agent.policy_delay=1",),
    "coarse_goal": ("agent.fine_goal=null",),
    "augmentation": ("buffer.augmentation={}",),
    "no_augmentation": ("buffer.augmentation=null",),
    "td3": ("agent.name=td3",),
}
"""End of a run's name -> what it changes. A task whose spec has the value already is left out."""


def applies(task: str, changes: tuple[str, ...]) -> bool:
    """Whether these settings are not those of the spec that ships, and suit it."""
    if _shipped(task).demonstrations is not None and any("imitat" in change for change in changes):
        return False  # hindsight's goals are imitated where no demonstrations are
    if ships(task, changes):
        return False
    try:
        check_parts(load_spec(_path(task), changes))
    except UsageError:
        return False
    return True


def ships(task: str, changes: tuple[str, ...]) -> bool:
    """Whether the spec that ships has these settings already."""
    return load_spec(_path(task), changes).hash() == _shipped(task).hash()


@cache
def _shipped(task: str) -> Spec:
    return load_spec(_path(task))


def _path(task: str) -> Path:
    return ROOT / "specs" / f"panda_{task}.yaml"


def commands() -> list[str]:
    """A line per trial and seed without a reference run."""
    lines = []
    for seed in range(5):
        for key, changes in TRIALS.items():
            for task, steps in STEPS.items():
                if seed >= SEEDS and task != "reach":
                    continue
                name = f"panda_{task}_{key}"
                if not (ROOT / "runs" / "reference" / f"{name}-s{seed}").is_dir() and applies(task, changes):
                    words = [f"specs/panda_{task}.yaml", *changes, f"name={name}", f"training.steps={steps}"]
                    words += ["testing.final_episodes=0", f"seeds=[{seed}]"]
                    lines.append(f"karolos run {shlex.join(words)}")
    return lines


def area(run: RunRecord, task: str) -> float:
    """The mean success at the last step of the episode over the tests of a run until the trial's last step."""
    tests = [test.success_end or 0.0 for test in run.tests if test.steps <= 1.1 * STEPS[task]]
    return fmean(tests)


def rows(found: Mapping[str, Contender]) -> list[list[str]]:
    """A row per setting: what it changes, its areas less those of the shipped spec by task, and how often it is better.

    The last cell is the probability that a run with the setting has a larger area than one of the shipped spec, the
    mean over tasks, with its 95 % bootstrap interval stratified by task (Agarwal et al. 2021), and the number of tasks.
    A single task has no interval.
    """
    table = []
    for key, changes in TRIALS.items():
        pairs = {
            task: tuple([area(run, task) for run in found[name].runs] for name in names)
            for task in STEPS
            if set(names := (f"panda_{task}_{key}", f"panda_{task}")) <= set(found)
        }
        if pairs:
            cells = [
                f"{fmean(pairs[task][0]) - fmean(pairs[task][1]):+.2f}" if task in pairs else "=" * ships(task, changes)
                for task in STEPS
            ]
            table.append([f"`{' '.join(changes)}`", *cells, _better(list(pairs.values()), SeedTree(0).child(key))])
    return table


def _better(pairs: list[tuple[list[float], ...]], tree: SeedTree) -> str:
    found = f"{fmean(improvement(one, other) for one, other in pairs):.2f}"
    if len(pairs) == 1:
        return f"{found} (1)"
    sizes = [len(runs) for pair in pairs for runs in pair]
    most = np.repeat(sizes, sizes)
    drawn = np.split(tree.generator().integers(0, most, (RESAMPLES, most.size)), np.cumsum(sizes)[:-1], axis=1)
    again = np.zeros(RESAMPLES)
    for (one, other), ours, theirs in zip(pairs, drawn[::2], drawn[1::2], strict=True):
        # 2 where a run is better than one of the shipped spec, 1 where they are equal
        wins = np.greater.outer(one, other) + np.greater_equal.outer(one, other).astype(int)
        again += wins[ours[:, :, None], theirs[:, None, :]].mean(axis=(1, 2)) / 2 / len(pairs)
    low, high = np.quantile(again, LEVELS)
    return f"{found} [{low:.2f}, {high:.2f}] ({len(pairs)})"


if __name__ == "__main__":
    print("\n".join(commands()))
