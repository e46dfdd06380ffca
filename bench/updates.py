"""Gradient updates per second of each agent that learns from replay, next to stable-baselines3 (PyTorch) and SBX (JAX).

All have two hidden layers of 256 units, batches of 256, 20 observed numbers and 4 actions, and sample from a full
buffer of their own. With one thread, processor time counts, which other programs hardly change.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from copy import deepcopy
from functools import partial
from importlib import import_module
from itertools import product
from statistics import median
from time import perf_counter, process_time
from typing import Annotated, Any, Literal

import gymnasium
import numpy as np
import torch
from typer import Option

from karolos.agents.device import resolve_device, use_threads, uses_bfloat16
from karolos.core import Agent, Batch, Discrete, Field, Layout, Signature
from karolos.core.seeding import SeedTree
from karolos.errors import MachineError
from karolos.registry import load

from .buffers import filled_buffer
from .side_by_side import Row, beside, require, seconds_of, take_turns

OBSERVED, ACTIONS, HIDDEN, BATCH = 20, 4, (256, 256), 256
STORED = 50_000
"""Transitions in each buffer."""
EPISODE = 50
TURN = 8
"""Updates of a contestant in one turn."""
AGENTS = ("sac", "td3", "ddpg", "dqn")
PEERS = {"stable_baselines3": "stable-baselines3", "sbx": "SBX"}
"""Module to import -> name."""

Update = Callable[[], None]  # makes TURN updates


def measure(
    *,
    only: list[str] | None = None,
    threads: Annotated[int, Option(min=1)] = 1,
    device: Literal["auto", "cpu", "cuda"] = "cpu",
    peers: bool = False,
    seconds: float = 20.0,
) -> Iterator[Row]:
    """Updates per second with sampling, and without it ("learning alone"). Binds this process to a core per thread.

    Args:
        only: names of agents; by default sac, td3, ddpg and dqn.
        peers: also time the same algorithms of stable-baselines3 and SBX, where they are installed.
        seconds: for all measurements together.

    Raises UsageError for an unknown agent, MachineError for more threads than cores or where no peer is installed.
    """
    hint = "pip install stable-baselines3 sbx-rl, in an environment of its own beside karolos"
    modules = require(*PEERS, hint=hint) if peers else []
    cores = sorted(os.sched_getaffinity(0))
    if threads > len(cores):
        raise MachineError(f"{threads} threads are requested, and this process may use {len(cores)} cores")
    os.sched_setaffinity(0, cores[:threads])  # before JAX is imported, which otherwise uses every core
    use_threads(threads)
    on = resolve_device(device)
    where = on if on != "cpu" else f"{threads} thread{'s' if threads > 1 else ''}"
    ours = {case: update for agent in only or AGENTS for case, update in _ours(agent, on)}
    theirs = {
        (agent, PEERS[module]): _peer_update(getattr(import_module(module), agent.upper()), on, discrete=agent == "dqn")
        for module, agent in product(modules, only or AGENTS)
        if hasattr(import_module(module), agent.upper())
    }

    def rate(update: Update, _: int) -> float:
        def finished() -> None:
            update()
            if on != "cpu":
                torch.cuda.synchronize(on)

        return TURN / seconds_of(finished, process_time if where == "1 thread" else perf_counter)

    contestants = {key: partial(rate, update) for key, update in (*ours.items(), *theirs.items())}
    take_turns(contestants)  # the first updates compile
    rates = take_turns(contestants, seconds=seconds)
    for case in ours:
        rivals = [key for key in theirs if key[0] == case.split()[0] and "alone" not in case]
        for key in rivals:
            yield beside(f"{case}, {where}", rates[case], "updates/s", key[1], rates[key])
        if not rivals:
            yield Row(f"{case}, {where}", median(rates[case]), "updates/s")


def _ours(name: str, device: str) -> Iterator[tuple[str, Update]]:
    """An agent in each precision that the device computes in, with sampling and without."""
    plugin: Any = load("agents", name)
    actions = Discrete(tuple(map(str, range(ACTIONS)))) if name == "dqn" else Layout((Field("action", ACTIONS),))
    signature = Signature(Layout((Field("observation", OBSERVED),)), actions, EPISODE, reward_range=(-1.0, 0.0))
    buffer = filled_buffer("uniform", signature, STORED // (20 * EPISODE), STORED)
    for precision in ("float32", "bfloat16") if uses_bfloat16("auto", device) else ("float32",):
        settings = plugin.Settings(hidden=HIDDEN, discount=0.99, precision=precision)
        agent, batch = plugin(settings, signature, SeedTree(0), device), deepcopy(buffer.sample(BATCH))
        yield f"{name} {precision}", partial(_learn, agent, partial(buffer.sample, BATCH))
        yield f"{name} {precision}, learning alone", partial(_learn, agent, partial(lambda batch: batch, batch))


def _learn(agent: Agent, sample: Callable[[], Batch]) -> None:
    for _ in range(TURN):
        agent.learn(sample())


def _peer_update(algorithm: Any, device: str, *, discrete: bool) -> Update:
    """The library's own defaults, with our sizes and a full buffer."""
    sizes = {"batch_size": BATCH, "buffer_size": STORED, "policy_kwargs": {"net_arch": list(HIDDEN)}}
    model = algorithm("MlpPolicy", _Spaces(discrete=discrete), device=device, seed=0, **sizes)
    model.set_logger(import_module("stable_baselines3.common.logger").Logger(None, []))
    buffer, generator = model.replay_buffer, np.random.Generator(np.random.PCG64(0))
    for array in (buffer.observations, buffer.next_observations, buffer.rewards):
        array[:] = generator.standard_normal(array.shape, np.float32)
    if discrete:
        buffer.actions[:] = generator.integers(ACTIONS, size=buffer.actions.shape)
    else:
        buffer.actions[:] = generator.uniform(-1, 1, buffer.actions.shape)
    buffer.full = True
    return partial(model.train, gradient_steps=TURN, batch_size=BATCH)


class _Spaces(gymnasium.Env[Any, Any]):
    """Spaces alone: updates neither reset nor step this environment."""

    def __init__(self, *, discrete: bool) -> None:
        spaces = gymnasium.spaces
        self.observation_space = spaces.Box(-np.inf, np.inf, (OBSERVED,), np.float32)
        self.action_space = spaces.Discrete(ACTIONS) if discrete else spaces.Box(-1.0, 1.0, (ACTIONS,), np.float32)
