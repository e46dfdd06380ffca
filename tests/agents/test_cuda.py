"""Agents on a GPU: they run there, and learn what they learn on a CPU."""

import pytest
import torch
from support.parts import batch, suited

from karolos.agents.ddpg import DDPG
from karolos.agents.dqn import DQN
from karolos.agents.sac import SAC
from karolos.agents.td3 import TD3
from karolos.core.seeding import SeedTree


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
@pytest.mark.parametrize(("kind", "options"), [(SAC, {}), (SAC, {"critic": {}}), (TD3, {}), (DDPG, {}), (DQN, {})])
def test_an_agent_learns_on_a_gpu_what_it_learns_on_a_cpu(kind, options):
    values, of = [], suited(kind)
    settings = kind.Settings.model_validate({"hidden": (16, 16), "precision": "float32", "discount": 0.0, **options})
    for device in ("cpu", "cuda"):
        agent = kind(settings, of, SeedTree(0), device)
        for seed in range(200):
            metrics = agent.learn(batch(32, of, seed, reward=2, terminated=1))
            if "value_mean" in metrics:
                value = metrics["value_mean"]
        assert value.device.type == device
        data = batch(8, of, 99)
        assert agent.act(data.observation, data.desired_goal, explore=True).shape == (8, of.action.size)
        agent.load_state(agent.state())
        values.append(value.item())
    assert values[1] == pytest.approx(values[0], abs=0.1)
