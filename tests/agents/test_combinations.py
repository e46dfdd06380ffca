"""Every agent learns with every buffer that goes with it, with and without hindsight and several steps at once."""

from itertools import product
from typing import Any

import numpy as np
import pytest

from karolos.core.seeding import SeedTree
from karolos.evaluation.testing import play_episodes, test_seeds
from karolos.experiment.check import check_parts
from karolos.registry import load, names
from karolos.specification import Spec, spec_from_dict
from karolos.training.assembly import make_agent, make_buffer, make_orchestrator
from karolos.training.training import Training

LINE = {"name": "toy", "dimensions": 1, "threshold": 0.2, "max_steps": 10}
BITS = {"name": "bit_flip", "bits": 4}
SMALL = {"hidden": [32, 32], "learning_rate": 3e-3, "discount": 0.9}

ALL = {"hindsight": {"ratio": 0.5}, "n_step": 3}
COMBINATIONS: list[tuple[str, dict[str, Any]]] = [
    ("ppo", {"name": "on_policy"}),
    *product(("sac", "td3", "ddpg"), ({"name": "uniform", **ALL}, {"name": "priority"})),
    # with the agent that is fast: no option, one alone (hindsight below), and all with the other buffer
    *product(["dqn"], ({"name": "uniform"}, {"name": "uniform", "n_step": 3}, {"name": "uniform", **ALL})),
    ("dqn", {"name": "priority", **ALL}),
]
"""Agents with buffers that learn from the same kind of experience."""


def spec_of(agent: str, buffer: dict[str, Any], environment: dict[str, Any] | None = None) -> Spec:
    training: dict[str, Any] = {"steps": 8_000}
    if agent != "ppo":
        steps = 450 if "hindsight" in buffer and environment is None else 700
        training = {"steps": steps, "batch_size": 64, "replay_ratio": 64, "warmup_episodes": 16}
    return spec_from_dict(
        {
            "environment": environment or (BITS if agent == "dqn" else LINE),
            "agent": {"name": agent, **SMALL, **({"tau": 0.05, "epsilon_steps": 500} if agent == "dqn" else {})},
            "buffer": buffer if agent == "ppo" else {"capacity": 10_000, **buffer},
            "orchestrator": {"name": "local", "processes": 0, "environments": 8},
            "training": training,
        }
    )


def named(combination: tuple[str, dict[str, Any]]) -> str:
    agent, buffer = combination
    return " ".join([agent, buffer["name"], *(key for key in ("hindsight", "n_step") if key in buffer)])


@pytest.mark.parametrize("combination", COMBINATIONS, ids=named)
def test_it_learns(combination):
    before, after = learned(spec_of(*combination))
    assert before < 0.5
    assert after > 0.9


def learned(spec: Spec) -> tuple[float, float]:
    """Success before and after training."""
    seeds = SeedTree(0)
    check_parts(spec)
    with make_orchestrator(spec, randomize=True) as environments, make_orchestrator(spec, randomize=False) as tests:
        agent = make_agent(spec, environments.signature, seeds)
        buffer = make_buffer(
            spec, environments.signature, seeds, environments=environments.size, discount=agent.discount
        )

        def success() -> float:
            result = play_episodes(tests, agent, test_seeds(0, 64), steps=0, seconds=0.0)
            return float(np.mean(result.end))

        before = success()
        for _ in Training(environments, agent, buffer, spec.training, seeds).rounds():
            pass
        return before, success()


@pytest.mark.parametrize("hindsight", [True, False])
def test_bits_that_chance_hardly_flips_right_are_learned_with_hindsight_only(hindsight):
    buffer = {"name": "uniform"} | ({"hindsight": {}} if hindsight else {})
    spec = spec_of("dqn", buffer, {"name": "bit_flip", "bits": 8})
    _, after = learned(spec)
    assert after > 0.8 if hindsight else after < 0.2


def test_every_agent_and_buffer_that_ships_is_there():
    there = {"agents": {agent for agent, _ in COMBINATIONS}, "buffers": {one["name"] for _, one in COMBINATIONS}}
    for kind, learned_with in there.items():
        assert learned_with == {name for name in names(kind) if load(kind, name).__module__.startswith("karolos.")}
