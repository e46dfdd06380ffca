"""What is asked of `actor_critic`: that it is found, what every agent promises, and that it learns."""

from __future__ import annotations

from pathlib import Path

import pytest

from karolos import Experiment
from karolos.core import Discrete, Field, Layout, Signature
from karolos.core.seeding import SeedTree
from karolos.errors import UsageError
from karolos.plugins.contracts import check
from karolos.registry import find, load

SPEC = {
    "environment": {"name": "toy", "dimensions": 1, "reward": "dense"},
    "agent": "actor_critic",
    "buffer": {"name": "uniform", "hindsight": {}},
    "orchestrator": {"name": "local", "processes": 0, "environments": 8},
    "training": {"steps": 800, "batch_size": 64, "replay_ratio": 32, "warmup_episodes": 8},
    "testing": {"interval": 800, "episodes": 32},
}


def test_it_is_found_by_its_entry_point() -> None:
    assert find("agents", "actor_critic").distribution == "karolos-actor-critic"


def test_it_keeps_what_every_agent_promises() -> None:
    check("agents", "actor_critic")


def test_it_learns_to_reach_a_point(tmp_path: Path) -> None:
    (run,) = Experiment(SPEC).run(tmp_path).runs
    assert run.success_end >= 0.9


def test_discrete_actions_are_refused() -> None:
    plugin = load("agents", "actor_critic")
    signature = Signature(observation=Layout((Field("x", 4),)), action=Discrete(("left", "right")), max_steps=10)
    with pytest.raises(UsageError, match="continuous"):
        plugin(plugin.Settings(), signature, SeedTree(0))
