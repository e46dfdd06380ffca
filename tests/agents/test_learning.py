"""SAC with hindsight replay learns what neither does alone: a sparse reward."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from karolos.agents.sac import SAC
from karolos.buffers.uniform import Uniform
from karolos.core import Transitions
from karolos.core.seeding import SeedTree
from karolos.environments.toy import Toy

ENVIRONMENTS = 16


def play(agent: SAC, worlds: list[Toy], seeds: range, buffer: Uniform | None = None, **learn: Any) -> float:
    """One episode in each world; share of goals held at the end. With a buffer: explore, store and learn."""
    steps = [world.reset(seed) for world, seed in zip(worlds, seeds, strict=True)]
    observation, _, goal = (np.stack(field) for field in list(zip(*steps, strict=True))[:3])
    for _ in range(worlds[0].signature.max_steps):
        actions = agent.act(observation, goal, explore=buffer is not None)
        steps = [world.step(action) for world, action in zip(worlds, actions, strict=True)]
        following = np.stack([step.observation for step in steps])
        if buffer is not None:
            buffer.add(
                Transitions(
                    environment=np.arange(len(worlds)),
                    observation=observation,
                    achieved_goal=observation,
                    desired_goal=goal,
                    action=actions,
                    reward=np.float32([step.reward for step in steps]),
                    next_observation=following,
                    next_achieved_goal=following,
                    terminated=np.bool_([step.terminated for step in steps]),
                    truncated=np.bool_([step.truncated for step in steps]),
                )
            )
            for _ in range(learn["updates"]):
                agent.learn(buffer.sample(128))
        observation = following
    return float(np.mean([step.success for step in steps]))


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_a_goal_that_chance_hardly_finds_is_learned_with_hindsight(precision: str) -> None:
    worlds = [Toy(Toy.Settings()) for _ in range(ENVIRONMENTS)]
    signature = worlds[0].signature
    agent = SAC(SAC.Settings.model_validate({"hidden": (64, 64), "precision": precision}), signature, SeedTree(0))
    settings = Uniform.Settings.model_validate({"capacity": 10_000, "hindsight": {}})
    buffer = Uniform(settings, signature, SeedTree(0), environments=ENVIRONMENTS, discount=agent.discount)
    before = np.mean([play(agent, worlds, range(1000 + 16 * k, 1016 + 16 * k)) for k in range(4)])
    for episode in range(8):
        play(agent, worlds, range(16 * episode, 16 * episode + 16), buffer, updates=4)
    after = np.mean([play(agent, worlds, range(1000 + 16 * k, 1016 + 16 * k)) for k in range(4)])
    assert before < 0.2
    assert after > 0.9
