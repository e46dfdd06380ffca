"""Exploration noise: what each kind looks like over an episode, and that it goes on where it stopped."""

from typing import Any

import numpy as np
import pytest
import torch
from support import parts
from support.parts import batch, signature

from karolos.agents.ddpg import DDPG
from karolos.agents.noise import Noise, NoiseSettings
from karolos.agents.sac import SAC
from karolos.agents.td3 import TD3
from karolos.core import Agent

ENVIRONMENTS = 2000


def make(**settings: Any) -> Noise:
    return Noise(NoiseSettings(**settings), inputs=3, actions=2, device=torch.device("cpu"))


def drawn(noise: Noise, steps: int, rows: torch.Tensor | None = None) -> torch.Tensor:
    """Successive draws: (steps, environments, actions)."""
    generator = torch.Generator().manual_seed(0)
    rows = torch.ones(ENVIRONMENTS, 3) if rows is None else rows
    return torch.stack([noise.draw(rows, generator) for _ in range(steps)])


KINDS = [{"kind": "gaussian"}, {"kind": "ornstein_uhlenbeck"}, {"kind": "state_dependent", "interval": 3}]


@pytest.mark.parametrize("settings", KINDS)
def test_noise_of_every_kind_is_standard_normal_at_every_step(settings):
    found = drawn(make(**settings), 5)
    for step in found:
        assert step.mean().item() == pytest.approx(0, abs=0.06)
        assert step.std().item() == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize(
    ("settings", "correlation"),
    [(KINDS[0], 0.0), ({"kind": "ornstein_uhlenbeck", "theta": 0.3}, 0.7), ({"kind": "state_dependent"}, 1.0)],
)
def test_successive_noise_is_as_akin_as_its_kind_says(settings, correlation):
    first, second = drawn(make(**settings), 2)
    assert np.corrcoef(first.ravel(), second.ravel())[0, 1] == pytest.approx(correlation, abs=0.05)


def test_state_dependent_noise_is_a_function_of_the_state_for_its_interval():
    noise = make(kind="state_dependent", interval=2)
    here, there = torch.randn(4, 3), torch.randn(4, 3)
    generator = torch.Generator().manual_seed(0)
    first, elsewhere, renewed = (noise.draw(rows, generator) for rows in (here, there, here))
    assert (first != elsewhere).all()
    assert (first != renewed).all()
    again = make(kind="state_dependent", interval=2)
    same = again.draw(torch.cat((here, here)), torch.Generator().manual_seed(1))
    assert (same[:4] != same[4:]).all()  # a matrix for each environment


@pytest.mark.parametrize("settings", KINDS[1:])
def test_what_is_remembered_belongs_to_one_environment_and_one_episode(settings):
    noise, generator = make(**settings), torch.Generator().manual_seed(0)
    noise.draw(torch.ones(4, 3), generator)
    first = noise.state()
    noise.draw(torch.ones(2, 3), generator, np.array([3, 1]))
    second = noise.state()
    assert second["age"].tolist() == [1, 2, 1, 2]
    assert torch.equal(second["memory"][[0, 2]], first["memory"][[0, 2]]), "only the named environments step"
    noise.begin(np.array([1]))
    noise.draw(torch.ones(4, 3), generator)
    third = noise.state()
    assert third["age"].tolist() == [2, 1, 2, 3]
    if settings["kind"] == "state_dependent":  # its interval is not over in environments whose episodes go on
        kept = (third["memory"] == second["memory"]).flatten(1).all(1)
        assert kept.tolist() == [True, False, True, True]


@pytest.mark.parametrize("agent", [SAC, DDPG, TD3])
@pytest.mark.parametrize("settings", KINDS[1:])
def test_exploring_goes_on_bit_for_bit_in_a_fresh_agent(agent, settings):
    def act(of: Agent, seed: int) -> np.ndarray:
        data = batch(4, signature(), seed)
        return of.act(data.observation, data.desired_goal, explore=True)

    first, second = (parts.make(agent, seed=seed, noise=settings) for seed in (0, 1))
    for step in range(4):
        act(first, step)
        if step == 1:
            first.begin_episodes(np.array([2]))
    second.load_state(first.state())
    for step in range(4, 9):
        np.testing.assert_array_equal(act(first, step), act(second, step))


def test_sac_explores_with_the_spread_that_its_policy_gives():
    agent = parts.make(SAC, hidden=(16,), random_actions=0, noise={"kind": "state_dependent"})
    agent.policy.named["layer1.weight"].zero_()
    agent.policy.named["layer1.bias"].copy_(torch.tensor([[0.1, 0.1, -3.0, -3.0]]))
    data = batch(ENVIRONMENTS, signature())
    found = np.arctanh(agent.act(data.observation, data.desired_goal, explore=True))
    assert found.std() == pytest.approx(np.exp(-3), rel=0.1)
    assert found.mean() == pytest.approx(0.1, abs=0.01)
