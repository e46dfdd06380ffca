"""How environments scale over processes and threads: the paper's two experiments, steps per second, the parent's cost.

The experiments (Bitter, Thun, Meisen 2022, figures on CPUs and threads) time a number of resets in layouts with one
environment per thread, over processes, and over threads at the largest number of processes. The peers are gymnasium's
vector environments on the same environments.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from itertools import product
from statistics import median
from time import perf_counter, process_time, sleep
from typing import Annotated

import numpy as np
from typer import Option

from karolos.core import Array, Environment, Field, Layout, Orchestrator, Received, Signature, Step, random_actions
from karolos.environments.build import build_environment
from karolos.gym import environment_ids
from karolos.registry import load
from karolos.specification import spec_from_dict
from karolos.system import cores

from .side_by_side import Row, beside, seconds_of, take_turns
from .vector import ROUNDS, vector_rate

WAIT = 2e-3
"""Seconds that a step of the waiting environment takes, as a device or another program would."""
RAY_WAITS = (3e-4, 1e-3, 3e-3, 1e-2)
"""Seconds per step of the environments that actors of Ray step."""
AtLeastOne = Annotated[int, Option(min=1)]
Build = Callable[[], Environment]


class Waiting(Environment):
    """Each reset and step sleeps `seconds`, which frees Python's interpreter lock."""

    def __init__(self, seconds: float) -> None:
        self.signature = Signature(Layout((Field("zero", 1),)), Layout((Field("unused", 1),)), max_steps=100)
        self._seconds, self._steps = seconds, 0

    def reset(self, seed: int) -> Step:  # noqa: ARG002  (every episode is the same)
        self._steps = -1
        return self.step(np.zeros(1))

    def step(self, action: Array) -> Step:  # noqa: ARG002
        sleep(self._seconds)
        self._steps += 1
        no_goal = np.zeros(0, np.float32)
        return Step(np.zeros(1, np.float32), no_goal, no_goal, 0.0, False, self._steps == 100, False)


def measure(
    *,
    robot: str = "panda",
    task: str = "reach",
    resets: AtLeastOne = 1_000,
    more_resets: AtLeastOne = 10_000,
    repeats: AtLeastOne = 10,
    seconds: float = 1.0,
    threads: AtLeastOne = 5,
    environments: AtLeastOne = 8,
) -> Iterator[Row]:
    """Resets, steps, and environments that wait, over processes, threads and actors of Ray. Takes minutes.

    Args:
        resets: in each layout of the experiment over processes.
        more_resets: in each layout of the experiment over threads, and of a second one over processes.
        repeats: turns of each layout; half as many where steps are counted.
        seconds: of stepping, in each layout and turn.
        environments: per process, where steps are counted.
    """
    spec = spec_from_dict({"robot": robot, "task": task, "agent": "sac"})
    build = partial(build_environment, spec.recipe(randomize=False))
    counts = process_counts()
    over_processes = [(count, 1) for count in counts]
    over_threads = [(counts[-1], each) for each in range(1, threads + 1)]
    for layouts, number, peer in (
        (over_processes, resets, "1 process"),
        (over_processes, more_resets, "1 process"),
        (over_threads, more_resets, "1 thread"),
    ):
        contestants = {layout: partial(_seconds_of_resets, build, *layout, number) for layout in layouts}
        times = take_turns(contestants, turns=repeats)
        for layout, found in times.items():
            case = f"{robot} {task} {number} resets, {layout[0]} processes x {layout[1]} threads"
            yield beside(case, found, "s", peer, times[layouts[0]])
    yield from _steps(build, f"{robot} {task}", environments, seconds, max(repeats // 2, 1))
    yield from _waiting(threads, seconds)
    yield from _ray(2 * environments, seconds, max(repeats // 4, 1))


def process_counts() -> list[int]:
    """Numbers of processes to measure: 1, 2, 4 ... and one per core."""
    return sorted({*(2**power for power in range(cores().bit_length())), cores()})


def _seconds_of_resets(build: Build, processes: int, threads: int, number: int, _: int) -> float:
    """Seconds for a number of resets; each environment that is ready gets the next."""
    with _orchestrator("local", build, processes=processes, threads=threads, environments=1) as orchestrator:

        def reset(number: int) -> None:
            ready, begun, ended = np.arange(min(orchestrator.size, number)), 0, 0
            while ended < number:
                ready = ready[: number - begun]
                orchestrator.reset(ready, range(begun, begun + ready.size))
                begun += ready.size
                ready = _received(orchestrator, 1).environment
                ended += ready.size

        reset(2 * orchestrator.size)  # a world's first reset loads it
        return seconds_of(partial(reset, number))


def _orchestrator(name: str, build: Build, **settings: int) -> Orchestrator:
    plugin = load("orchestrators", name)
    orchestrator: Orchestrator = plugin(plugin.Settings(**settings), build)
    return orchestrator


def _received(orchestrator: Orchestrator, at_least: int | None) -> Received:
    """What arrives. Raises the error of an environment that failed, which would not be stepped any more."""
    received = orchestrator.receive(at_least)
    for failure in received.failures:
        raise failure.error
    return received


def steps_per_second(orchestrator: Orchestrator, seconds: float, at_least: int | None = None) -> float:
    """Steps per second of wall-clock time with random actions, when `at_least` environments are ready (None: all)."""
    generator = np.random.Generator(np.random.PCG64(0))
    actions = [random_actions(orchestrator.signature, orchestrator.size, generator) for _ in range(ROUNDS)]
    orchestrator.reset(range(orchestrator.size), range(orchestrator.size))
    steps, started = 0, perf_counter()
    while steps == 0 or perf_counter() - started < seconds:
        ready, step, *_ = _received(orchestrator, at_least)
        over = step.terminated | step.truncated
        going = ready[~over]
        if over.any():
            orchestrator.reset(ready[over], (steps + ready[over]).tolist())
        if going.size:
            orchestrator.step(going, actions[steps % ROUNDS][: going.size])
        steps += going.size
    rate = steps / (perf_counter() - started)
    orchestrator.receive()
    return rate


def _steps(build: Build, what: str, environments: int, seconds: float, turns: int) -> Iterator[Row]:
    """Steps per second over processes, in lockstep and asynchronously, beside gymnasium's vector environments."""
    counts = process_counts()
    costs: dict[int, list[float]] = {}

    def rate(count: int, mode: str, _: int) -> float:
        with _orchestrator("local", build, processes=count, environments=environments) as orchestrator:
            at_least = None if mode == "lockstep" else max(orchestrator.size // 2, 1)
            steps_per_second(orchestrator, 0.0, at_least)  # a world's first reset loads it
            wall, cpu = perf_counter(), process_time()
            found = steps_per_second(orchestrator, seconds, at_least)
            if count and mode == "lockstep":
                costs.setdefault(count, []).append((process_time() - cpu) / (perf_counter() - wall) / found)
        return found

    kinds = list(product((0, *counts), ("lockstep", "asynchronous")))
    contestants: dict[tuple[int, str], Callable[[int], float]] = {kind: partial(rate, *kind) for kind in kinds}
    for count in (0, *counts):
        kind = (count, "async") if count else (environments, "sync")  # its processes have one environment each
        contestants[count, "gymnasium"] = partial(vector_rate, _id(*what.split()), *kind, seconds)
    rates = take_turns(contestants, turns=turns)
    for count, mode in kinds:
        found, case = rates[count, mode], f"{what} {count} processes x {environments} environments, {mode}"
        peer = "gymnasium AsyncVectorEnv" if count else "gymnasium SyncVectorEnv"
        yield beside(case, found, "steps/s", peer, rates[count, "gymnasium"])
        if count > 1:
            yield beside(case, found, "steps/s", "1 process", rates[1, mode])
    for count, cost in costs.items():
        yield Row(f"parent's CPU time, {count} processes", 1e6 * median(cost), "us/step")


def _id(*pair: str) -> str:
    return next(name for name, its in environment_ids().items() if its == pair)


def _waiting(threads: int, seconds: float) -> Iterator[Row]:
    """Environments that wait, which threads speed up."""

    def rate(number: int, _: int) -> float:
        layout = {"processes": 1, "threads": number, "environments": 2 * threads // number}
        with _orchestrator("local", partial(Waiting, WAIT), **layout) as made:
            return steps_per_second(made, seconds)

    rates = take_turns({number: partial(rate, number) for number in range(1, threads + 1)}, turns=1)
    for number, found in rates.items():
        case = f"waiting environment ({1e3 * WAIT:g} ms), 1 process x {number} threads"
        yield beside(case, found, "steps/s", "1 thread", rates[1])


def _ray(size: int, seconds: float, turns: int) -> Iterator[Row]:
    """Environments that wait, in one and in two actors of Ray, beside one process of this machine."""
    if find_spec("ray") is None:
        print("Ray is not installed: environments on other machines are not measured.", file=sys.stderr)
        return

    def rate(workers: int, wait: float, _: int) -> float:
        settings = {"workers": workers, "environments": size // workers} if workers else {"environments": size}
        with _orchestrator("ray" if workers else "local", partial(Waiting, wait), **settings) as made:
            return steps_per_second(made, seconds)

    for wait in RAY_WAITS:
        rates = take_turns({workers: partial(rate, workers, wait) for workers in range(3)}, turns=turns)
        case = f"waiting environment ({1e3 * wait:g} ms) x {size}"
        yield beside(f"{case}, 1 actor of Ray", rates[1], "steps/s", "1 process", rates[0])
        yield beside(f"{case}, 2 actors of Ray", rates[2], "steps/s", "1 actor of Ray", rates[1])
