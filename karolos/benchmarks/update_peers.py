"""The same algorithms of other libraries, ready to be timed: stable-baselines3 (PyTorch) and SBX (JAX)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import gymnasium
import numpy as np

LIBRARIES = {"stable_baselines3": "stable-baselines3", "sbx": "SBX"}
"""Module to import -> name."""


@dataclass(frozen=True)
class Shape:
    """What everybody learns: columns observed, actions, hidden units, rows of a batch, transitions stored."""

    observed: int
    actions: int
    hidden: tuple[int, ...]
    batch: int
    stored: int


@dataclass(frozen=True)
class Peer:
    """One algorithm of one library; `update` makes that many updates, sampling included."""

    agent: str
    library: str
    update: Callable[[int], None]


def installed() -> list[str]:
    """Modules of the libraries that are installed."""
    return [module for module in LIBRARIES if find_spec(module) is not None]


def peers(agents: Sequence[str], shape: Shape, device: str) -> Iterator[Peer]:
    """Each agent's counterpart in each library that is installed and has it."""
    for module in installed():
        for agent in agents:
            kind = getattr(import_module(module), agent.upper(), None)
            if kind is not None:
                yield Peer(agent, LIBRARIES[module], _ready(kind, agent, shape, device))


def _ready(kind: Any, agent: str, shape: Shape, device: str) -> Callable[[int], None]:
    """The algorithm with a full buffer and the library's own defaults elsewhere; a function that updates it."""
    model = kind(
        "MlpPolicy",
        _Nothing(shape, discrete=agent == "dqn"),
        batch_size=shape.batch,
        buffer_size=shape.stored,
        policy_kwargs={"net_arch": list(shape.hidden)},
        device=device,
        seed=0,
    )
    _, callback = model._setup_learn(total_timesteps=1)  # gives it the logger that updates write to
    del callback
    buffer, generator = model.replay_buffer, np.random.Generator(np.random.PCG64(0))
    for array in (buffer.observations, buffer.next_observations, buffer.rewards):
        array[:] = generator.standard_normal(array.shape, np.float32)
    if agent == "dqn":
        buffer.actions[:] = generator.integers(shape.actions, size=buffer.actions.shape)
    else:
        buffer.actions[:] = generator.uniform(-1, 1, buffer.actions.shape)
    buffer.full = True

    def update(count: int) -> None:
        model.train(gradient_steps=count, batch_size=shape.batch)

    return update


class _Nothing(gymnasium.Env[Any, Any]):
    """Spaces without a world: updates never step it."""

    def __init__(self, shape: Shape, *, discrete: bool) -> None:
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (shape.observed,), np.float32)
        self.action_space = (
            gymnasium.spaces.Discrete(shape.actions)
            if discrete
            else gymnasium.spaces.Box(-1.0, 1.0, (shape.actions,), np.float32)
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed, options=options)
        return np.zeros(self.observation_space.shape or (), np.float32), {}
