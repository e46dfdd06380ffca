"""Trials of single settings on each task, which tell which of them matter.

python docs/_scripts/trials.py   print the commands of the trials that runs/reference does not hold
"""

from __future__ import annotations

import shlex
from pathlib import Path

from karolos.specification import load_spec

ROOT = Path(__file__).parents[2]
SEEDS = (0, 1)
STEPS = {
    "push": 60_000,
    "pick": 40_000,
    "throw": 40_000,
    "insert": 40_000,
    "stack_demos": 20_000,
    "slide_demos": 40_000,
    "open": 40_000,
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
    "learning_rate": ("agent.learning_rate=5e-4",),
    "slow_targets": ("agent.tau=0.01",),
    "three_layers": ("agent.hidden=[256,256,256]",),
    "no_layer_norm": ("agent.layer_norm=false",),
    "quantiles": ("agent.critic={quantiles: 25}",),
    "policy_delay": ("agent.policy_delay=1",),
    "coarse_goal": ("agent.fine_goal=null",),
    "td3": ("agent.name=td3",),
}
"""End of a run's name -> what it changes. A task whose spec has the value already is left out."""


def applies(task: str, changes: tuple[str, ...]) -> bool:
    """Whether these settings are not those of the spec that ships, and suit it."""
    spec = load_spec(ROOT / "specs" / f"panda_{task}.yaml")
    if spec.demonstrations is not None and any("imitat" in change for change in changes):
        return False  # hindsight's goals are imitated where no demonstrations are
    return load_spec(ROOT / "specs" / f"panda_{task}.yaml", changes).hash() != spec.hash()


def commands() -> list[str]:
    """A line per trial and seed without a reference run."""
    lines = []
    for seed in SEEDS:
        for key, changes in TRIALS.items():
            for task, steps in STEPS.items():
                name = f"panda_{task}_{key}"
                if not (ROOT / "runs" / "reference" / f"{name}-s{seed}").is_dir() and applies(task, changes):
                    words = [f"specs/panda_{task}.yaml", *changes, f"name={name}", f"training.steps={steps}"]
                    words += ["testing.final_episodes=0", f"seeds=[{seed}]"]
                    lines.append(f"karolos run {shlex.join(words)}")
    return lines


if __name__ == "__main__":
    print("\n".join(commands()))
