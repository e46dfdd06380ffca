"""What agents say of their updates, by the names under which it stands in TensorBoard."""

import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.parts import batch, make, rollout, signature, suited

from karolos.agents.ddpg import DDPG
from karolos.agents.dqn import DQN
from karolos.agents.optimisation import REPORT_EVERY
from karolos.agents.ppo import PPO
from karolos.agents.sac import SAC
from karolos.agents.td3 import TD3

CRITICS = {"critic_loss", "value_mean", "value_max", "target_mean", "critic_gradient_norm", "critic_learning_rate"}
POLICY = {"policy_loss", "policy_gradient_norm", "policy_learning_rate", "action_saturation"}
ENTROPY = {"entropy", "temperature", "temperature_learning_rate"}
PPOS = {
    "policy_loss",
    "value_loss",
    "kl",
    "clip_fraction",
    "entropy",
    "gradient_norm",
    "value_gradient_norm",
    "explained_variance",
    "value_mean",
    "policy_learning_rate",
    "value_learning_rate",
}
CONTINUOUS = {"action_saturation", "std", "std_learning_rate"}
REPLAYING = [
    (SAC, {}, CRITICS | POLICY | ENTROPY),
    (SAC, {"critic": {}}, CRITICS | POLICY | ENTROPY),
    (SAC, {"policy_delay": 2}, CRITICS | POLICY | ENTROPY),
    (SAC, {"imitation": 1.0}, CRITICS | POLICY | ENTROPY | {"imitation_loss"}),
    (TD3, {}, CRITICS | POLICY),
    (TD3, {"policy_delay": 3, "imitation": 1.0}, CRITICS | POLICY | {"imitation_loss"}),
    (DDPG, {}, CRITICS | POLICY),
    (DQN, {}, {"value_loss", "value_mean", "value_max", "target_mean", "gradient_norm", "epsilon", "learning_rate"}),
]


def updates(kind: Any, options: dict[str, Any], count: int) -> Iterator[dict[str, Any]]:
    """What so many updates in a row say, demonstrations among what is learned from."""
    agent, of = make(kind, hidden=(8,), **options), suited(kind)
    for seed in range(count):
        data = batch(16, of, seed)
        yield dict(agent.learn(data._replace(demonstrated=np.ones(16, np.float32))))


@pytest.mark.parametrize(("kind", "options", "series"), REPLAYING)
def test_replaying_agents_say_what_their_authors_would_look_at(kind, options, series):
    every = REPORT_EVERY * options.get("policy_delay", 2 if kind is TD3 else 1)
    made = updates(kind, options, 2 * every)
    for _ in range(2):  # in each stretch of updates, not in the first alone
        told: dict[str, Any] = {}
        for metrics in islice(made, every):
            told |= metrics
        assert set(told) == series | {"priorities"}
        assert told["priorities"].shape == (16,)
        assert all(np.isfinite(float(value)) for name, value in told.items() if name != "priorities")


@pytest.mark.parametrize(("kind", "options"), [(kind, options) for kind, options, _ in REPLAYING if not options])
def test_most_updates_say_priorities_alone_and_take_no_time_for_more(kind, options):
    told = [set(metrics) for metrics in updates(kind, options, 4 * REPORT_EVERY)]
    assert sum(names == {"priorities"} for names in told) == len(told) * (1 - 1 / REPORT_EVERY)


@pytest.mark.parametrize(
    ("of", "series"),
    [(signature(), PPOS | CONTINUOUS), (signature(labels=3), PPOS)],
    ids=["continuous", "discrete"],
)
def test_ppo_says_of_each_rollout_what_its_authors_would_look_at(of, series):
    agent = make(PPO, of, epochs=2, minibatches=2)
    for _ in range(2):
        told = dict(agent.learn(rollout(agent, of)))
        assert told.pop("updates") == 4
        assert set(told) == series
        assert all(np.isfinite(float(value)) for value in told.values())


def test_the_page_on_tensorboard_lists_what_agents_say_and_nothing_else():
    page = (Path(__file__).parents[2] / "docs" / "tensorboard.md").read_text()
    listed = set(re.findall(r"^\| `agent/(\w+)`", page, re.MULTILINE))
    assert listed == set.union(PPOS, CONTINUOUS, *(series for _, _, series in REPLAYING))
