"""`gymnasium.make_vec` over the orchestrator, next to gymnasium's AsyncVectorEnv with a process per environment."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from time import perf_counter
from typing import Annotated, Any

import gymnasium
from typer import Option

from .side_by_side import Row, beside, take_turns

ROUNDS = 64
"""Rounds of random actions that are drawn before the measurement and then repeated."""
ASYNC, OWN = "async", "vector_entry_point"


def measure(
    *,
    name: Annotated[str, Option(metavar="ID")] = "karolos/PandaReach-v1",
    environments: Annotated[list[int] | None, Option(min=1, metavar="N")] = None,
    seconds: float = 2.0,
    turns: Annotated[int, Option(min=1)] = 5,
) -> Iterator[Row]:
    """Steps per second with random actions, resets included.

    Args:
        name: of a registered environment.
        environments: numbers of environments; by default 2, 8 and 32.
        seconds: of each turn.
    """
    for count in environments or (2, 8, 32):
        rates = take_turns(
            {mode: partial(vector_rate, name, count, mode, seconds) for mode in (OWN, ASYNC)}, turns=turns
        )
        yield beside(f"{name} x {count}", rates[OWN], "steps/s", "gymnasium AsyncVectorEnv", rates[ASYNC])


def vector_rate(name: str, count: int, mode: str, seconds: float, _: int) -> float:
    """Steps per second of `count` environments that `gymnasium.make_vec` makes."""
    more: dict[str, Any] = {"vector_kwargs": {"context": "forkserver"}} if mode == ASYNC else {}
    together: Any = gymnasium.make_vec(f"karolos.gym:{name}", num_envs=count, vectorization_mode=mode, **more)
    together.reset(seed=0)
    together.action_space.seed(0)
    actions = [together.action_space.sample() for _ in range(ROUNDS)]
    together.step(actions[0])
    steps, started = 0, perf_counter()
    while steps == 0 or perf_counter() - started < seconds:
        together.step(actions[steps // count % ROUNDS])
        steps += count
    rate = steps / (perf_counter() - started)
    together.close()
    return rate
