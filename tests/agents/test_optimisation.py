"""Adam over vectors: schedules, cut gradients, and a state that goes on."""

import pytest
import torch
from support.parts import batch, make, signature

from karolos.agents.ddpg import DDPG
from karolos.agents.optimisation import Adam
from karolos.agents.sac import SAC
from karolos.agents.td3 import TD3
from karolos.agents.torch_agent import OptimiserSettings


def test_the_learning_rate_falls_with_the_steps_and_stays():
    settings = OptimiserSettings(learning_rate=1.0, learning_rate_end=0.5, learning_rate_updates=2)
    assert [settings.rate(update) for update in range(4)] == [1.0, 0.75, 0.5, 0.5]


def test_the_first_step_has_the_length_of_the_learning_rate():
    vector = torch.zeros(4)
    Adam(vector, 0.1).step(torch.full((4,), 3.0))
    torch.testing.assert_close(vector, torch.full((4,), -0.1))


def test_longer_gradients_are_cut_and_shorter_ones_left():
    optimiser = Adam(torch.zeros(4), 0.1, norm=1.0)
    long, short = torch.full((4,), 3.0), torch.full((4,), 0.1)
    optimiser.step(long)
    assert optimiser.gradient_norm().item() == pytest.approx(6)
    assert torch.linalg.vector_norm(long).item() == pytest.approx(1)
    optimiser.step(short)
    assert optimiser.gradient_norm().item() == pytest.approx(0.2)
    torch.testing.assert_close(short, torch.full((4,), 0.1))


@pytest.mark.parametrize("kind", [SAC, TD3, DDPG])
@pytest.mark.parametrize("delay", [1, 2, 3])
def test_every_optimiser_steps_at_its_turn_and_its_rate_reaches_its_end_with_the_updates_of_the_agent(kind, delay):
    settings = {"learning_rate": 1e-2, "learning_rate_end": 1e-3, "learning_rate_updates": 12, "hidden": (8,)}
    if kind is not DDPG:
        settings["policy_delay"] = delay
    agent = make(kind, **settings)
    rates = {name: [] for name in agent.optimisers}
    for update in range(18):
        if update == 9:  # a resumed agent goes on with the schedule
            state = agent.state()
            agent = make(kind, **settings)
            agent.load_state(state)
        before = {name: optimiser.steps for name, optimiser in agent.optimisers.items()}
        agent.learn(batch(8, signature(), update))
        for name, optimiser in agent.optimisers.items():
            if optimiser.steps > before[name]:
                assert optimiser.learning_rate == pytest.approx(1e-2 - 9e-3 * min(update / 12, 1))
                rates[name].append(optimiser.learning_rate)
    for name, found in rates.items():
        assert len(found) == (18 if name == "critic" or kind is DDPG else 18 // delay)
        assert found[-1] == 1e-3
