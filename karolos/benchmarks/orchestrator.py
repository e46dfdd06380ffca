"""How environments scale over processes and threads: the paper's two experiments, steps per second, the parent's cost.

The experiments (Bitter, Thun, Meisen 2022, figures on CPUs and threads) time a number of resets in layouts with one
environment per thread, over processes, and over threads at the largest number of processes. The peers are gymnasium's
vector environments on the same environments. All layouts are measured in turn, several times over; figures are
medians, because a machine is never alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from statistics import median
from time import perf_counter, process_time
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core import Orchestrator, random_actions
from ..orchestrator.local import Local
from ..orchestrator.probe import DRAWN, Measured, choose, cores, process_counts, steps_per_second
from ..registry import load
from ..report.boxes import Panel
from ..spec.recipe import Part, Recipe
from .row import Row
from .waiting import Waiting

if TYPE_CHECKING:
    from gymnasium.vector import VectorEnv

NAME = "orchestrator"
ASYNC_PEER, SYNC_PEER = "gymnasium AsyncVectorEnv", "gymnasium SyncVectorEnv"
ONE_PROCESS, ONE_THREAD = "1 process", "1 thread"
WAIT = 2e-3
"""Seconds that a step of the waiting environment takes: a program on the same machine, a device on its bus."""


@dataclass(frozen=True)
class Amounts:
    """How much to measure."""

    resets: int = 1_000
    """In each layout of the experiment over processes."""
    more_resets: int = 10_000
    """In each layout of the experiment over threads, as in each of that over processes once more."""
    repeats: int = 10
    seconds: float = 1.0
    """Of stepping, in each layout and repeat."""
    threads: int = 5
    environments: int = 8
    """Per process, where steps are counted."""


QUICK = Amounts(resets=20, more_resets=40, repeats=2, seconds=0.05, threads=2, environments=2)


@dataclass
class Report:
    """What was found: rows, what the figure shows, and what to do on this machine."""

    rows: list[Row] = field(default_factory=list)
    panels: list[Panel] = field(default_factory=list)
    advice: list[str] = field(default_factory=list)


def measure(robot: str = "panda", task: str = "reach", amounts: Amounts | None = None) -> Report:
    """All of it.

    Raises:
        UsageError: no such robot or task.
    """
    amounts = amounts or Amounts()
    recipe = Recipe(_part("environments", "robot_task"), _part("robots", robot), _part("tasks", task))
    counts = list(process_counts(cores()))
    report = Report()
    for resets in (amounts.resets, amounts.more_resets):
        layouts = [(count, 1) for count in counts]
        _add_resets(report, recipe, f"{robot} {task}", layouts, resets, amounts.repeats)
    layouts = [(counts[-1], threads) for threads in range(1, amounts.threads + 1)]
    _add_resets(report, recipe, f"{robot} {task}", layouts, amounts.more_resets, amounts.repeats)
    _add_steps(report, recipe, robot, task, amounts)
    _add_waiting(report, amounts)
    return report


def _part(kind: str, name: str) -> Part:
    return Part(kind, name, load(kind, name).Settings())


def _add_resets(
    report: Report, recipe: Recipe, what: str, layouts: list[tuple[int, int]], resets: int, repeats: int
) -> None:
    """Seconds for a number of resets; whoever is ready gets the next."""
    times: dict[tuple[int, int], list[float]] = {layout: [] for layout in layouts}
    for _ in range(repeats):
        for (processes, threads), found in times.items():
            settings = Local.Settings(processes=processes, threads=threads, environments=1)
            with Local(settings, recipe) as orchestrator:
                _seconds_for(orchestrator, 2 * orchestrator.size)  # a world's first reset loads it
                found.append(_seconds_for(orchestrator, resets))
    over = "threads" if layouts[0][0] == layouts[-1][0] and len(layouts) > 1 and layouts[-1][1] > 1 else "processes"
    peer, peer_value = (ONE_PROCESS if over == "processes" else ONE_THREAD), median(times[layouts[0]])
    for (processes, threads), found in times.items():
        case = f"{what} {resets} resets, {processes} processes x {threads} threads"
        report.rows.append(Row(NAME, case, median(found), "s", peer, peer_value))
    place = 1 if over == "threads" else 0
    beside = "" if over == "processes" else f", {layouts[0][0]} processes"
    report.panels.append(
        Panel(
            f"{resets:,} resets of {what}{beside}", over, "s", {str(key[place]): found for key, found in times.items()}
        )
    )


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


def _add_steps(report: Report, recipe: Recipe, robot: str, task: str, amounts: Amounts) -> None:
    """Steps per second over processes, in lockstep and as they come, beside gymnasium's vector environments."""
    counts = list(process_counts(cores()))
    ours = {(count, mode): [] for count in (0, *counts) for mode in (lockstep, asynchronous)}  # type: ignore[var-annotated]
    costs: dict[int, list[float]] = {count: [] for count in counts}
    theirs: dict[int, list[float]] = {count: [] for count in (0, *counts)}
    for _ in range(max(amounts.repeats // 2, 1)):
        for (count, mode), found in ours.items():
            settings = Local.Settings(processes=count, environments=amounts.environments)
            with Local(settings, recipe) as orchestrator:
                mode(orchestrator, 0.0)  # a world's first reset loads it
                wall, cpu = perf_counter(), process_time()
                found.append(mode(orchestrator, amounts.seconds))
                if count and mode is lockstep:
                    costs[count].append((process_time() - cpu) / (perf_counter() - wall) / found[-1])
        for count, found in theirs.items():
            found.append(_peer_steps(robot, task, count, amounts))
    per_second = {key: median(found) for key, found in ours.items()}
    for (count, mode), value in per_second.items():
        case = f"{robot} {task} {count} processes x {amounts.environments} environments, {mode.__name__}"
        peer = SYNC_PEER if count == 0 else ASYNC_PEER
        report.rows.append(Row(NAME, case, value, "steps/s", peer, median(theirs[count])))
        if count > 1:
            report.rows.append(Row(NAME, case, value, "steps/s", ONE_PROCESS, per_second[1, mode]))
    for count, found in costs.items():
        report.rows.append(Row(NAME, f"parent's CPU time, {count} processes", 1e6 * median(found), "us/step"))
    best = choose([Measured(count, 1, value) for (count, mode), value in per_second.items() if mode is lockstep])
    report.advice.append(
        f"This machine ({cores()} cores) should use orchestrator.processes={best.processes}: {robot} {task} makes "
        f"{best.steps_per_second:,.0f} steps/s, and {per_second[1, lockstep]:,.0f} with one process."
    )
    report.advice.append(
        "Threads do not speed PyBullet up: it holds Python's interpreter lock while it steps, so that they take turns."
    )


def lockstep(orchestrator: Orchestrator, seconds: float) -> float:
    """Steps per second when each round waits for all."""
    return steps_per_second(orchestrator, seconds)


def asynchronous(orchestrator: Orchestrator, seconds: float) -> float:
    """Steps per second when half of the environments are enough to act on."""
    half = max(orchestrator.size // 2, 1)
    generator = np.random.Generator(np.random.PCG64(0))
    actions = [random_actions(orchestrator.signature, orchestrator.size, generator) for _ in range(DRAWN)]
    orchestrator.reset(range(orchestrator.size), range(orchestrator.size))
    steps, started = 0, perf_counter()
    while steps == 0 or perf_counter() - started < seconds:
        ready, step, *_ = orchestrator.receive(at_least=half)
        over = step.terminated | step.truncated
        going = ready[~over]
        if over.any():
            orchestrator.reset(ready[over], (steps + ready[over]).tolist())
        if going.size:
            orchestrator.step(going, actions[steps % DRAWN][: going.size])
        steps += going.size
    rate = steps / (perf_counter() - started)
    orchestrator.receive()
    return rate


def _peer_steps(robot: str, task: str, processes: int, amounts: Amounts) -> float:
    """Steps per second of gymnasium's vector environment; its processes have one environment each."""
    from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv  # noqa: PLC0415  (takes a while)

    from ..environments.gymnasium_export import RobotTaskEnv  # noqa: PLC0415

    make: Callable[[], Any] = partial(RobotTaskEnv, robot, task)
    together: VectorEnv[Any, Any, Any]
    if processes:
        together = AsyncVectorEnv([make] * processes, context="forkserver")
    else:
        together = SyncVectorEnv([make] * amounts.environments)
    together.reset(seed=0)
    together.action_space.seed(0)
    actions = [together.action_space.sample() for _ in range(DRAWN)]
    together.step(actions[0])
    steps, started = 0, perf_counter()
    while steps == 0 or perf_counter() - started < amounts.seconds:
        together.step(actions[steps // together.num_envs % DRAWN])
        steps += together.num_envs
    rate = steps / (perf_counter() - started)
    together.close()
    return rate


def _add_waiting(report: Report, amounts: Amounts) -> None:
    """What threads are good for: environments that wait."""
    rates: dict[int, float] = {}
    for threads in range(1, amounts.threads + 1):
        with Local(Local.Settings(processes=1, threads=threads), WAIT, size=2 * amounts.threads, build=Waiting) as made:
            rates[threads] = steps_per_second(made, amounts.seconds)
    for threads, rate in rates.items():
        case = f"waiting environment ({1e3 * WAIT:g} ms), 1 process x {threads} threads"
        report.rows.append(Row(NAME, case, rate, "steps/s", ONE_THREAD, rates[1]))
    gain = rates[max(rates)] / rates[1]
    report.advice.append(
        f"Threads are good for environments that wait for a device, a socket or another program: {max(rates)} threads "
        f"make one that sleeps {1e3 * WAIT:g} ms a step {gain:.1f} times as fast."
    )
