"""Gradient updates per second of each agent that learns from replay, beside stable-baselines3 (PyTorch) and SBX (JAX).

All have two hidden layers of 256 units, batches of 256, 20 observed numbers and 4 actions, and sample from a full
buffer of their own. Each number of threads gets a process of its own, bound to as many cores, which also binds JAX.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from copy import deepcopy
from importlib import import_module
from importlib.util import find_spec
from statistics import median
from time import perf_counter
from typing import Any

import gymnasium
import numpy as np

from ..agents.device import synchronise, use_threads
from ..core import Discrete, Field, Layout, Signature
from ..core.seeding import SeedTree
from ..errors import MachineError
from ..registry import load, names
from .buffers import NoiseEpisode, filled_buffer
from .side_by_side import Row, beside, take_turns

NAME = "updates"
OBSERVED, ACTIONS, HIDDEN, BATCH = 20, 4, (256, 256), 256
STORED = 50_000
"""Transitions in each buffer."""
EPISODE = 50
TURN = 8
"""Updates of a contestant in one turn."""
AGENTS = ("sac", "td3", "ddpg", "dqn")
PRECISIONS = ("float32", "bfloat16")
PEERS = {"stable_baselines3": "stable-baselines3", "sbx": "SBX"}
"""Module to import -> name."""

Update = Callable[[int], None]
"""Makes this many updates."""


def measure(
    *,
    agents: Sequence[str] = AGENTS,
    threads: Sequence[int] = (1,),
    device: str = "cpu",
    peers: bool = False,
    seconds: float = 20.0,
) -> Iterator[Row]:
    """Updates per second with sampling, and without it ("learning alone"). Agents that are not installed are left out.

    Args:
        agents: names of agents.
        threads: numbers of CPU threads, measured one after the other.
        device: cpu or cuda.
        peers: also time the same algorithms of stable-baselines3 and SBX, where they are installed.
        seconds: for each number of threads.

    Raises:
        MachineError: fewer cores than threads, or peers are requested and none is installed.
    """
    if peers and not installed_peers():
        raise MachineError(
            "neither stable-baselines3 nor sbx-rl is installed, so there is no peer to measure",
            hint="pip install stable-baselines3 sbx-rl, in an environment of its own beside karolos",
        )
    for count in threads:
        if count > len(_cores()):
            raise MachineError(f"{count} threads are requested, and this process may use {len(_cores())} cores")
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(1, mp_context=context, initializer=_bind, initargs=(count,)) as pool:
            yield from pool.submit(_measure, tuple(agents), count, device, peers, seconds).result()


def installed_peers() -> list[str]:
    """Modules of the peers that are installed."""
    return [module for module in PEERS if find_spec(module) is not None]


def _cores() -> list[int]:
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def _bind(threads: int) -> None:
    """Restrict this process to one core per thread."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, _cores()[:threads])
    use_threads(threads)


def _measure(agents: tuple[str, ...], threads: int, device: str, peers: bool, seconds: float) -> list[Row]:
    where = device if device != "cpu" else f"{threads} thread{'s' if threads > 1 else ''}"
    ours = {case: update for agent in agents if agent in names("agents") for case, update in _ours(agent, device)}
    theirs = dict(_peers(agents, device)) if peers else {}

    def timed(update: Update) -> Callable[[int], float]:
        update(2 * TURN)  # compiles and warms up
        update(TURN)

        def rate(_: int) -> float:
            started = perf_counter()
            update(TURN)
            synchronise(device)
            return TURN / (perf_counter() - started)

        return rate

    contestants = {key: timed(update) for key, update in (*ours.items(), *theirs.items())}
    rates = take_turns(contestants, seconds=seconds)
    rows = []
    for case in ours:
        rivals = [key for key in theirs if key[0] == case.split()[0] and "alone" not in case]
        rows += [beside(NAME, f"{case}, {where}", rates[case], "updates/s", key[1], rates[key]) for key in rivals]
        if not rivals:
            rows.append(Row(NAME, f"{case}, {where}", median(rates[case]), "updates/s"))
    return rows


def _ours(name: str, device: str) -> Iterator[tuple[str, Update]]:
    """An agent in each of its precisions, with sampling and without."""
    plugin: Any = load("agents", name)
    signature = _signature(discrete=name == "dqn")
    buffer = filled_buffer("uniform", signature, NoiseEpisode(signature, STORED // (20 * EPISODE)), STORED)
    has_precision = "precision" in plugin.Settings.model_fields
    for precision in PRECISIONS if has_precision else ("float32",):
        settings = {"hidden": HIDDEN, "discount": 0.99} | ({"precision": precision} if has_precision else {})
        agent = plugin(plugin.Settings(**settings), signature, SeedTree(0), device)
        batch = deepcopy(buffer.sample(BATCH))

        def with_sampling(count: int, agent: Any = agent) -> None:
            for _ in range(count):
                agent.learn(buffer.sample(BATCH))

        def alone(count: int, agent: Any = agent, batch: Any = batch) -> None:
            for _ in range(count):
                agent.learn(batch)

        yield f"{name} {precision}", with_sampling
        yield f"{name} {precision}, learning alone", alone


def _signature(*, discrete: bool) -> Signature:
    action = Discrete(tuple(map(str, range(ACTIONS)))) if discrete else Layout((Field("action", ACTIONS),))
    return Signature(Layout((Field("observation", OBSERVED),)), action, EPISODE, reward_range=(-1.0, 0.0))


def _peers(agents: Sequence[str], device: str) -> Iterator[tuple[tuple[str, str], Update]]:
    """(agent, library) and its updates, for each installed library that has the agent's algorithm."""
    for module in installed_peers():
        for agent in agents:
            algorithm = getattr(import_module(module), agent.upper(), None)
            if algorithm is not None:
                yield (agent, PEERS[module]), _peer_update(algorithm, device, discrete=agent == "dqn")


def _peer_update(algorithm: Any, device: str, *, discrete: bool) -> Update:
    """The library's own defaults, with our sizes and a full buffer."""
    model = algorithm(
        "MlpPolicy",
        _Spaces(discrete=discrete),
        batch_size=BATCH,
        buffer_size=STORED,
        policy_kwargs={"net_arch": list(HIDDEN)},
        device=device,
        seed=0,
    )
    model._setup_learn(total_timesteps=1)  # sets the logger that updates write to
    buffer, generator = model.replay_buffer, np.random.Generator(np.random.PCG64(0))
    for array in (buffer.observations, buffer.next_observations, buffer.rewards):
        array[:] = generator.standard_normal(array.shape, np.float32)
    if discrete:
        buffer.actions[:] = generator.integers(ACTIONS, size=buffer.actions.shape)
    else:
        buffer.actions[:] = generator.uniform(-1, 1, buffer.actions.shape)
    buffer.full = True

    def update(count: int) -> None:
        model.train(gradient_steps=count, batch_size=BATCH)

    return update


class _Spaces(gymnasium.Env[Any, Any]):
    """Spaces alone: updates never step this environment."""

    def __init__(self, *, discrete: bool) -> None:
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (OBSERVED,), np.float32)
        self.action_space = (
            gymnasium.spaces.Discrete(ACTIONS) if discrete else gymnasium.spaces.Box(-1.0, 1.0, (ACTIONS,), np.float32)
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed, options=options)
        return np.zeros(OBSERVED, np.float32), {}
