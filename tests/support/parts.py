"""Small signatures and batches for tests of agents."""

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import layer_norm, linear

from karolos.agents.dqn import DQN
from karolos.agents.networks import MLP
from karolos.agents.ppo import PPO
from karolos.core import Batch, Discrete, Field, Layout, Rollout, Signature
from karolos.core.seeding import SeedTree


def signature(
    *,
    observation: int = 3,
    goal: int = 2,
    action: int = 2,
    critic_only: int = 0,
    labels: int = 0,
    reward_range: tuple[float, float] = (-np.inf, np.inf),
) -> Signature:
    """Of a small environment; with `labels`, this is the number of its discrete actions."""
    goals = Layout((Field("goal", goal),)) if goal else Layout()
    return Signature(
        observation=Layout((Field("x", observation), Field("hidden", critic_only, critic_only=True))),
        action=Discrete(tuple(map(str, range(labels)))) if labels else Layout((Field("a", action),)),
        max_steps=50,
        reward_range=reward_range,
        achieved_goal=goals,
        desired_goal=goals,
    )


def jointed(others: tuple[Field, ...] = (), *more: Field) -> Signature:
    """Of an arm with three joints, which its observations and actions describe, with actions before and after these."""
    seen = Layout((Field("place", 4), Field("effects", 6, joints=3), Field("speeds", 3, joints=3)))
    moved = Layout((*others, Field("changes", 3, joints=3), *more))
    return replace(signature(), observation=seen, action=moved)


def make(kind: Any, of: Signature | None = None, seed: int = 0, **settings: Any) -> Any:
    """A small agent of this class; without `of` one of the environment of `suited`."""
    small = {"hidden": (32, 32), "learning_rate": 3e-3, "tau": 0.1, "precision": "float32"}
    if kind is PPO:
        small = {"hidden": (16,), "minibatches": 4, "epochs": 3}
    return kind(kind.Settings.model_validate({**small, **settings}), of or suited(kind), SeedTree(seed))


def suited(kind: Any, **of: Any) -> Signature:
    """A signature whose actions agents of this class take: four discrete ones for DQN, else continuous ones."""
    return signature(labels=4 if kind is DQN else 0, **of)


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
    """A batch of noise with uniform discrete actions; `fixed` gives whole fields as one number or as an array."""
    generator = np.random.default_rng(seed)

    def noise(columns: int) -> np.ndarray:
        return generator.normal(size=(size, columns)).astype(np.float32)

    made = Batch(
        observation=noise(of.observation.size),
        desired_goal=noise(of.desired_goal.size),
        action=_actions(of, noise(of.action.size), generator),
        reward=noise(1)[:, 0],
        next_observation=noise(of.observation.size),
        terminated=np.zeros(size, np.float32),
        discount=np.full(size, 0.95, np.float32),
        weight=np.ones(size, np.float32),
        slot=np.arange(size),
    )
    return _with_fields(made, fixed)


def rollout(agent: PPO, of: Signature, *, steps: int = 8, n: int = 4, seed: int = 0, **fixed: Any) -> Rollout:
    """A rollout through noise with the agent's own exploring actions; `fixed` gives whole fields."""
    generator = np.random.default_rng(seed)

    def noise(columns: int) -> np.ndarray:
        return generator.normal(size=(steps + 1, n, columns)).astype(np.float32)

    observation, goal = noise(of.observation.size), noise(of.desired_goal.size)[:-1]
    made = Rollout(
        observation=observation[:-1],
        desired_goal=goal,
        action=np.stack([agent.act(observation[t], goal[t], explore=True) for t in range(steps)]),
        reward=noise(1)[:-1, :, 0],
        next_observation=observation[1:],
        terminated=np.zeros((steps, n), np.bool_),
        ended=np.arange(steps)[:, None].repeat(n, 1) == steps - 1,
        stored=np.ones((steps, n), np.bool_),
    )
    return _with_fields(made, fixed)


def _actions(of: Signature, noise: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    if isinstance(of.action, Discrete):
        return generator.integers(len(of.action.labels), size=noise.shape).astype(np.float32)
    return np.tanh(noise)


def _with_fields(made: Any, fixed: dict[str, Any]) -> Any:
    """A batch or rollout with these fields replaced, each by one number or by an array."""
    given = {}
    for name, value in fixed.items():
        before = getattr(made, name)
        given[name] = np.broadcast_to(value, before.shape).astype(before.dtype)
    return made._replace(**given)
