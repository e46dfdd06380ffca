"""Small signatures and batches for tests of agents."""

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import layer_norm, linear

from karolos.agents.networks import MLP
from karolos.core import Batch, Field, Layout, Signature
from karolos.core.seeding import SeedTree


def signature(
    *,
    observation: int = 3,
    goal: int = 2,
    action: int = 2,
    critic_only: int = 0,
    reward_range: tuple[float, float] = (-np.inf, np.inf),
) -> Signature:
    goals = Layout((Field("goal", goal),)) if goal else Layout()
    return Signature(
        observation=Layout((Field("x", observation), Field("hidden", critic_only, critic_only=True))),
        action=Layout((Field("a", action),)),
        max_steps=50,
        reward_range=reward_range,
        achieved_goal=goals,
        desired_goal=goals,
    )


def make(kind: Any, of: Signature | None = None, seed: int = 0, **settings: Any) -> Any:
    """A small agent of this class."""
    chosen = {"hidden": (32, 32), "learning_rate": 3e-3, "tau": 0.1, "precision": "float32", **settings}
    return kind(kind.Settings.model_validate(chosen), of or signature(), SeedTree(seed))


def leaf(network: MLP) -> Tensor:
    """The network's parameters, for autograd."""
    return network.vector.clone().requires_grad_()


def plain(network: MLP, x: Tensor, parameters: Tensor | None = None) -> Tensor:
    """What a network gives for x, in torch's own float32 operations: (n, out) or (members, n, out).

    Args:
        network: says the shape.
        x: (n, in).
        parameters: laid out as its own, which they are by default.
    """
    shape = network.shape
    table = (network.vector if parameters is None else parameters).view(max(shape.members, 1), -1)
    found = []
    for row in table:
        h, place, sizes = x, 0, list(shape.parameters().values())
        for number, ((outs, ins), _) in enumerate(zip(sizes[::2], sizes[1::2], strict=True)):
            weight = row[place : place + outs * ins].view(outs, ins)
            place += outs * ins
            h = linear(h, weight, row[place : place + outs])
            place += outs
            if number < len(shape.sizes) - 2:
                h = torch.relu(layer_norm(h, h.shape[-1:]) if shape.layer_norm else h)
        found.append(h)
    return torch.stack(found) if shape.members else found[0]


def batch(size: int, of: Signature, seed: int = 0, **fixed: Any) -> Batch:
    """A batch of noise; `fixed` gives whole fields as one number or as an array."""
    generator = np.random.default_rng(seed)

    def noise(columns: int) -> np.ndarray:
        return generator.normal(size=(size, columns)).astype(np.float32)

    made = Batch(
        observation=noise(of.observation.size),
        desired_goal=noise(of.desired_goal.size),
        action=np.tanh(noise(of.action.size)),
        reward=noise(1)[:, 0],
        next_observation=noise(of.observation.size),
        terminated=np.zeros(size, np.float32),
        discount=np.full(size, 0.95, np.float32),
        weight=np.ones(size, np.float32),
        slot=np.arange(size),
    )
    given = {
        name: np.broadcast_to(np.asarray(value, np.float32), getattr(made, name).shape).copy()
        for name, value in fixed.items()
    }
    return made._replace(**given)
