"""Gradient updates per second of each agent that learns from replay, beside other libraries in the same run.

Everybody has two hidden layers of 256 units, batches of 256, 20 observed numbers and 4 actions, and samples from a full
buffer of its own. All take turns of a few updates, many times over; the figures are medians, because a machine is never
alone. Each number of threads gets a process of its own with as many cores: that is the one way that binds JAX too.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from copy import deepcopy
from dataclasses import dataclass, field
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np

from ..agents.device import synchronise, use_threads
from ..core import Discrete, Field, Layout, Signature, Transitions
from ..core.seeding import SeedTree
from ..errors import MachineError
from ..registry import load, names
from . import update_peers
from .row import Row

OBSERVED, ACTIONS, HIDDEN, BATCH = 20, 4, (256, 256), 256
STORED = 50_000
"""Transitions in everybody's buffer."""
EPISODE = 50
TURN = 8
"""Updates that one contestant makes before the next has its turn."""
AGENTS = ("sac", "td3", "ddpg", "dqn")
PRECISIONS = ("float32", "bfloat16")


@dataclass
class _Contestant:
    """Somebody whose updates are timed."""

    agent: str
    case: str
    update: Callable[[int], None]
    """Makes this many updates."""
    library: str | None = None
    """None: karolos."""
    seconds: list[float] = field(default_factory=list)
    """Per update, turn by turn."""

    @property
    def rate(self) -> float:
        """Updates per second."""
        return 1 / median(self.seconds)


def measure(
    *,
    agents: Sequence[str] = AGENTS,
    threads: Sequence[int] = (1,),
    device: str = "cpu",
    peers: bool = False,
    seconds: float = 20.0,
) -> Iterator[Row]:
    """Updates per second, sampling included; and without it ("learning alone"). Agents not installed are left out.

    Args:
        agents: names of agents.
        threads: numbers of CPU threads, measured one after the other.
        device: cpu or cuda.
        peers: also time the same algorithms of stable-baselines3 and SBX, where they are installed.
        seconds: for each number of threads.

    Raises:
        MachineError: fewer cores than threads, or peers asked for and none installed.
    """
    if peers and not update_peers.installed():
        raise MachineError(
            "neither stable-baselines3 nor sbx-rl is installed, so there is no peer to measure",
            hint="pip install stable-baselines3 sbx-rl, in an environment of its own beside karolos",
        )
    for count in threads:
        if count > len(_cores()):
            raise MachineError(f"{count} threads are asked for and {len(_cores())} cores are there")
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(1, mp_context=context, initializer=_bind, initargs=(count,)) as pool:
            yield from pool.submit(_measure, tuple(agents), count, device, peers, seconds).result()


def _cores() -> list[int]:
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def _bind(threads: int) -> None:
    """Leave this process as many cores as it may have threads."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, _cores()[:threads])
    use_threads(threads)


def _measure(agents: tuple[str, ...], threads: int, device: str, peers: bool, seconds: float) -> list[Row]:
    contestants = [found for agent in agents if agent in names("agents") for found in _ours(agent, device)]
    if peers:
        shape = update_peers.Shape(OBSERVED, ACTIONS, HIDDEN, BATCH, STORED)
        for peer in update_peers.peers(agents, shape, device):
            contestants.append(_Contestant(peer.agent, peer.agent, peer.update, peer.library))
    for contestant in contestants:
        contestant.update(2 * TURN)  # compiles and warms up; the next turn still may
        contestant.update(TURN)
    end, turns = perf_counter() + seconds, 0
    while perf_counter() < end or turns < 3:
        for contestant in contestants:
            started = perf_counter()
            contestant.update(TURN)
            synchronise(device)
            contestant.seconds.append((perf_counter() - started) / TURN)
        turns += 1
    where = device if device != "cpu" else f"{threads} thread{'s' if threads > 1 else ''}"
    rows = []
    for contestant in (one for one in contestants if one.library is None):
        case = f"{contestant.case}, {where}"
        rivals = [one for one in contestants if one.library and one.agent == contestant.agent]
        if not rivals or "alone" in case:
            rows.append(Row("updates", case, contestant.rate, "updates/s"))
        for rival in rivals if "alone" not in case else ():
            rows.append(Row("updates", case, contestant.rate, "updates/s", rival.library, rival.rate))
    return rows


def _ours(name: str, device: str) -> Iterator[_Contestant]:
    kind: Any = load("agents", name)
    signature = _signature(discrete=name == "dqn")
    buffer = _filled_buffer(signature)
    precisions = PRECISIONS if "precision" in kind.Settings.model_fields else ("float32",)
    for precision in precisions:
        settings = {"hidden": HIDDEN, "discount": 0.99}
        if len(precisions) > 1:
            settings["precision"] = precision
        agent = kind(kind.Settings(**settings), signature, SeedTree(0), device)
        batch = deepcopy(buffer.sample(BATCH))

        def whole(count: int, agent: Any = agent) -> None:
            for _ in range(count):
                agent.learn(buffer.sample(BATCH))

        def alone(count: int, agent: Any = agent, batch: Any = batch) -> None:
            for _ in range(count):
                agent.learn(batch)

        yield _Contestant(name, f"{name} {precision}", whole)
        yield _Contestant(name, f"{name} {precision}, learning alone", alone)


def _signature(*, discrete: bool) -> Signature:
    action = Discrete(tuple(map(str, range(ACTIONS)))) if discrete else Layout((Field("action", ACTIONS),))
    return Signature(Layout((Field("observation", OBSERVED),)), action, EPISODE, reward_range=(-1.0, 0.0))


def _filled_buffer(signature: Signature) -> Any:
    """A uniform buffer full of noise, from 50 environments."""
    kind: Any = load("buffers", "uniform")
    environments = STORED // (20 * EPISODE)
    buffer = kind(kind.Settings(capacity=STORED), signature, SeedTree(0), environments=environments, discount=0.99)
    generator = np.random.Generator(np.random.PCG64(0))
    nothing = np.zeros((environments, 0), np.float32)
    observation = generator.standard_normal((environments, OBSERVED), np.float32)
    for step in range(STORED // environments):
        following = generator.standard_normal((environments, OBSERVED), np.float32)
        if isinstance(signature.action, Discrete):
            action = generator.integers(ACTIONS, size=(environments, 1)).astype(np.float32)
        else:
            action = generator.uniform(-1, 1, (environments, ACTIONS)).astype(np.float32)
        buffer.add(
            Transitions(
                environment=np.arange(environments),
                observation=observation,
                achieved_goal=nothing,
                desired_goal=nothing,
                action=action,
                reward=-generator.random(environments, np.float32),
                next_observation=following,
                next_achieved_goal=nothing,
                terminated=np.zeros(environments, np.bool_),
                truncated=np.full(environments, step % EPISODE == EPISODE - 1),
            )
        )
        observation = following
    return buffer
