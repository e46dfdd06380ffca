"""How environments scale over processes and threads: the paper's two experiments, steps per second, the parent's cost.

The experiments (Bitter, Thun, Meisen 2022, figures on CPUs and threads) time a number of resets in layouts with one
environment per thread, over processes, and over threads at the largest number of processes. The peers are gymnasium's
vector environments on the same environments.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from importlib.util import find_spec
from statistics import median
from time import perf_counter, process_time
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core import BuildEnvironment, Orchestrator
from ..environments.build import build_environment
from ..machine import cores
from ..orchestrator.local import Local
from ..orchestrator.ray import Ray
from ..registry import load
from ..report.figures import BoxPlot
from ..spec.parts import Part, Recipe
from .side_by_side import Row, beside, take_turns
from .stepping import ROUNDS_OF_ACTIONS, rounds_of_actions, steps_per_second
from .waiting import Waiting

if TYPE_CHECKING:
    from gymnasium.vector import VectorEnv

NAME = "orchestrator"
ASYNC_PEER, SYNC_PEER = "gymnasium AsyncVectorEnv", "gymnasium SyncVectorEnv"
ONE_PROCESS, ONE_THREAD = "1 process", "1 thread"
WAIT = 2e-3
"""Seconds that a step of the waiting environment takes, as a device or another program would."""
RAY_WAITS = (3e-4, 1e-3, 3e-3, 1e-2)
"""Seconds per step of the environments that actors of Ray step."""


@dataclass(frozen=True)
class Amounts:
    """How much to measure."""

    resets: int = 1_000
    """In each layout of the experiment over processes."""
    more_resets: int = 10_000
    """In each layout of the experiment over threads, and of a second one over processes."""
    repeats: int = 10
    seconds: float = 1.0
    """Of stepping, in each layout and repeat."""
    threads: int = 5
    environments: int = 8
    """Per process, where steps are counted."""


QUICK = Amounts(resets=20, more_resets=40, repeats=2, seconds=0.05, threads=2, environments=2)


@dataclass
class Report:
    """Rows, the box plots of the figure, and advice for this machine."""

    rows: list[Row] = field(default_factory=list)
    plots: list[BoxPlot] = field(default_factory=list)
    advice: list[str] = field(default_factory=list)


def measure(robot: str = "panda", task: str = "reach", amounts: Amounts | None = None) -> Report:
    """Measure resets, steps and waiting environments.

    Raises:
        UsageError: the robot or the task is unknown.
    """
    amounts = amounts or Amounts()
    recipe = Recipe(_part("environments", "robot_task"), _part("robots", robot), _part("tasks", task))
    build = partial(build_environment, recipe)
    counts = process_counts()
    report = Report()
    for resets in (amounts.resets, amounts.more_resets):
        layouts = [(count, 1) for count in counts]
        _add_resets(report, build, f"{robot} {task}", layouts, resets, amounts.repeats)
    layouts = [(counts[-1], threads) for threads in range(1, amounts.threads + 1)]
    _add_resets(report, build, f"{robot} {task}", layouts, amounts.more_resets, amounts.repeats)
    _add_steps(report, build, robot, task, amounts)
    _add_waiting(report, amounts)
    _add_ray(report, amounts)
    return report


def process_counts() -> list[int]:
    """Numbers of processes to measure: 1, 2, 4 ... and one for each core."""
    return [*(2**power for power in range(16) if 2**power < cores()), cores()]


def _part(kind: str, name: str) -> Part:
    return Part(kind, name, load(kind, name).Settings())


def _add_resets(
    report: Report, build: BuildEnvironment, what: str, layouts: list[tuple[int, int]], resets: int, repeats: int
) -> None:
    """Seconds for a number of resets; each environment that is ready gets the next."""

    def seconds(processes: int, threads: int, _: int) -> float:
        with Local(Local.Settings(processes=processes, threads=threads, environments=1), build) as orchestrator:
            _seconds_for(orchestrator, 2 * orchestrator.size)  # a world's first reset loads it
            return _seconds_for(orchestrator, resets)

    times = take_turns({layout: partial(seconds, *layout) for layout in layouts}, turns=repeats)
    over_threads = layouts[-1][1] > 1
    peer = ONE_THREAD if over_threads else ONE_PROCESS
    for (processes, threads), found in times.items():
        case = f"{what} {resets} resets, {processes} processes x {threads} threads"
        report.rows.append(beside(NAME, case, found, "s", peer, times[layouts[0]]))
    title = f"{resets:,} resets of {what}" + (f", {layouts[0][0]} processes" if over_threads else "")
    boxes = {str(layout[1 if over_threads else 0]): found for layout, found in times.items()}
    report.plots.append(BoxPlot(title, "threads" if over_threads else "processes", "s", boxes))


def _seconds_for(orchestrator: Orchestrator, resets: int) -> float:
    started = perf_counter()
    ready, begun, ended = np.arange(min(orchestrator.size, resets)), 0, 0
    while ended < resets:
        ready = ready[: resets - begun]
        orchestrator.reset(ready, range(begun, begun + ready.size))
        begun += ready.size
        ready = orchestrator.receive(at_least=1).environment
        ended += ready.size
    return perf_counter() - started


def _add_steps(report: Report, build: BuildEnvironment, robot: str, task: str, amounts: Amounts) -> None:
    """Steps per second over processes, in lockstep and asynchronously, beside gymnasium's vector environments."""
    counts = process_counts()
    costs: dict[int, list[float]] = {count: [] for count in counts}

    def rate(count: int, mode: Callable[[Orchestrator, float], float], _: int) -> float:
        with Local(Local.Settings(processes=count, environments=amounts.environments), build) as orchestrator:
            mode(orchestrator, 0.0)  # a world's first reset loads it
            wall, cpu = perf_counter(), process_time()
            found = mode(orchestrator, amounts.seconds)
            if count and mode is steps_per_second:
                costs[count].append((process_time() - cpu) / (perf_counter() - wall) / found)
        return found

    modes = {"lockstep": steps_per_second, "asynchronous": asynchronous}
    contestants: dict[tuple[int, str], Callable[[int], float]] = {}
    for count in (0, *counts):
        for name, mode in modes.items():
            contestants[count, name] = partial(rate, count, mode)
        contestants[count, "gymnasium"] = partial(_peer_steps, robot, task, count, amounts)
    rates = take_turns(contestants, turns=max(amounts.repeats // 2, 1))
    for (count, mode_name), found in rates.items():
        if mode_name == "gymnasium":
            continue
        case = f"{robot} {task} {count} processes x {amounts.environments} environments, {mode_name}"
        peer = ASYNC_PEER if count else SYNC_PEER
        report.rows.append(beside(NAME, case, found, "steps/s", peer, rates[count, "gymnasium"]))
        if count > 1:
            report.rows.append(beside(NAME, case, found, "steps/s", ONE_PROCESS, rates[1, mode_name]))
    for count, cost in costs.items():
        report.rows.append(Row(NAME, f"parent's CPU time, {count} processes", 1e6 * median(cost), "us/step"))
    per_second = {count: median(rates[count, "lockstep"]) for count in (0, *counts)}
    best = max(counts, key=per_second.__getitem__)
    report.advice.append(
        f"This machine ({cores()} cores) should use orchestrator.processes={best}: {robot} {task} makes "
        f"{per_second[best]:,.0f} steps/s, and {per_second[1]:,.0f} with one process."
    )
    report.advice.append("Threads do not speed PyBullet up: it holds Python's interpreter lock while it steps.")


def asynchronous(orchestrator: Orchestrator, seconds: float) -> float:
    """Steps per second when half of the environments are enough to act on."""
    half = max(orchestrator.size // 2, 1)
    actions = rounds_of_actions(orchestrator)
    orchestrator.reset(range(orchestrator.size), range(orchestrator.size))
    steps, started = 0, perf_counter()
    while steps == 0 or perf_counter() - started < seconds:
        ready, step, *_ = orchestrator.receive(at_least=half)
        over = step.terminated | step.truncated
        going = ready[~over]
        if over.any():
            orchestrator.reset(ready[over], (steps + ready[over]).tolist())
        if going.size:
            orchestrator.step(going, actions[steps % ROUNDS_OF_ACTIONS][: going.size])
        steps += going.size
    rate = steps / (perf_counter() - started)
    orchestrator.receive()
    return rate


def _peer_steps(robot: str, task: str, processes: int, amounts: Amounts, _: int) -> float:
    """Steps per second of gymnasium's vector environment; its processes have one environment each."""
    from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv  # noqa: PLC0415  (takes a while)

    from ..environments.gymnasium.export import RobotTaskEnv  # noqa: PLC0415

    make: Callable[[], Any] = partial(RobotTaskEnv, robot, task)
    together: VectorEnv[Any, Any, Any]
    if processes:
        together = AsyncVectorEnv([make] * processes, context="forkserver")
    else:
        together = SyncVectorEnv([make] * amounts.environments)
    together.reset(seed=0)
    together.action_space.seed(0)
    actions = [together.action_space.sample() for _ in range(ROUNDS_OF_ACTIONS)]
    together.step(actions[0])
    steps, started = 0, perf_counter()
    while steps == 0 or perf_counter() - started < amounts.seconds:
        together.step(actions[steps // together.num_envs % ROUNDS_OF_ACTIONS])
        steps += together.num_envs
    rate = steps / (perf_counter() - started)
    together.close()
    return rate


def _add_waiting(report: Report, amounts: Amounts) -> None:
    """Environments that wait, which threads speed up."""

    def rate(threads: int, _: int) -> float:
        environments = 2 * amounts.threads // threads
        layout = Local.Settings(processes=1, threads=threads, environments=environments)
        with Local(layout, partial(Waiting, WAIT)) as made:
            return steps_per_second(made, amounts.seconds)

    rates = take_turns({threads: partial(rate, threads) for threads in range(1, amounts.threads + 1)}, turns=1)
    for threads, found in rates.items():
        case = f"waiting environment ({1e3 * WAIT:g} ms), 1 process x {threads} threads"
        report.rows.append(beside(NAME, case, found, "steps/s", ONE_THREAD, rates[1]))
    report.advice.append(
        f"Threads speed up environments that wait for a device, a socket or another program: {amounts.threads} threads "
        f"make one that sleeps {1e3 * WAIT:g} ms a step {report.rows[-1].ratio:.1f} times as fast."
    )


def _add_ray(report: Report, amounts: Amounts) -> None:
    """Environments that wait, in one and in two actors of Ray, beside one process of this machine."""
    if find_spec("ray") is None:
        report.advice.append("Ray is not installed: environments on other machines are not measured.")
        return
    size = 2 * amounts.environments

    def local(wait: float, _: int) -> float:
        with Local(Local.Settings(processes=1, environments=size), partial(Waiting, wait)) as made:
            return steps_per_second(made, amounts.seconds)

    def actors(workers: int, wait: float, _: int) -> float:
        settings = Ray.Settings(workers=workers, environments=size // workers)
        with Ray(settings, partial(Waiting, wait)) as made:
            return steps_per_second(made, amounts.seconds)

    pays: float | None = None
    for wait in RAY_WAITS:
        kinds = {0: partial(local, wait), 1: partial(actors, 1, wait), 2: partial(actors, 2, wait)}
        rates = take_turns(kinds, turns=max(amounts.repeats // 4, 1))
        case = f"waiting environment ({1e3 * wait:g} ms) x {size}"
        report.rows.append(beside(NAME, f"{case}, 1 actor of Ray", rates[1], "steps/s", ONE_PROCESS, rates[0]))
        report.rows.append(beside(NAME, f"{case}, 2 actors of Ray", rates[2], "steps/s", "1 actor of Ray", rates[1]))
        if pays is None and median(rates[2]) > 1.5 * median(rates[0]):
            pays = wait
    steps = (
        f"up to {1e3 * RAY_WAITS[-1]:g} ms a step are not" if pays is None else f"from {1e3 * pays:g} ms a step on are"
    )
    report.advice.append(f"{size} environments {steps} 1.5 times as fast in two actors of Ray as in one process.")
