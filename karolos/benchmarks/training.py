"""What overlapping collection with learning saves, and the seconds until an agent succeeds, beside a peer.

The first: a Panda learns to reach with one update per round. One worker process has as many environments as make a
round's steps cost as much as its update. It trains in lockstep, in lockstep without overlap (the loop waits for the
environments before it learns), and asynchronously. A turn is one episode of every environment.
The second: seconds until a test finds .95 success (`end`) on the same task, beside stable-baselines3's SAC with
hindsight on panda-gym. Each trains in a process of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from statistics import median
from time import perf_counter

from ..agents.device import use_threads
from ..core import Array, FloatArray, Orchestrator, Received
from ..core.seeding import SeedTree
from ..spec import Spec
from ..training.assembly import make_agent, make_buffer, make_orchestrator
from ..training.training import Progress, Training
from .end_to_end import EPISODES, INTERVAL, PEER, PEER_RECIPE, PEER_STEPS, Found, first_success, reach, require_peer
from .side_by_side import Row, beside, take_turns
from .stepping import steps_per_second

NAME = "training"
EPISODE = 50
"""Steps of an episode of reaching."""
OVERLAP, WITHOUT, ASYNC = "lockstep", "lockstep without overlap", "async"


@dataclass(frozen=True)
class Amounts:
    """How much to measure."""

    turns: int = 24
    """Turns of each variant."""
    probe: float = 2.0
    """Seconds to measure the speed of collecting, and as many for that of learning."""
    environments: int = 256
    """At most."""
    seeds: tuple[int, ...] = (0,)
    """Of the runs from start to success, and of the peer's."""


QUICK = Amounts(turns=2, probe=0.05, environments=2)


class WithoutOverlap(Orchestrator):
    """An orchestrator whose commands return only when they are carried out, so that nothing overlaps.

    Its results are those of the orchestrator that it wraps.
    """

    def __init__(self, wrapped: Orchestrator) -> None:
        self._wrapped = wrapped
        self.signature, self.size = wrapped.signature, wrapped.size
        self._received: Received | None = None

    def reset(self, environments: Sequence[int] | Array, seeds: Sequence[int]) -> None:
        self._wrapped.reset(environments, seeds)
        self._received = self._wrapped.receive()

    def step(self, environments: Sequence[int] | Array, actions: FloatArray, *, updates: int = 0) -> None:
        self._wrapped.step(environments, actions, updates=updates)
        self._received = self._wrapped.receive()

    def receive(self, at_least: int | None = None) -> Received:
        received, self._received = self._received, None
        return self._wrapped.receive(at_least) if received is None else received

    def parameters(self, environments: Sequence[int] | Array) -> FloatArray:
        return self._wrapped.parameters(environments)

    def close(self) -> None:
        self._wrapped.close()


def measure(
    amounts: Amounts | None = None,
    *,
    peers: bool = False,
    end_to_end: bool = True,
    say: Callable[[str], object] = print,
) -> Iterator[Row]:
    """Rows, each as soon as it is known.

    Args:
        amounts: how much to measure.
        peers: also train the peer.
        end_to_end: also train from start to success.
        say: receives a line about each run.

    Raises:
        MachineError: peers are requested and not installed.
        RunError: a run from start to success failed.
    """
    amounts = amounts or Amounts()
    if peers:
        require_peer()
    yield from overlap(amounts, say)
    if end_to_end:
        yield from _until_success(amounts.seeds, peers=peers, say=say)


def overlap(amounts: Amounts, say: Callable[[str], object]) -> Iterator[Row]:
    """Seconds for the same number of steps and updates with and without overlap, and asynchronously."""
    use_threads(1)
    spec = balanced(amounts, say)
    size = spec.orchestrator.settings.size
    with ExitStack() as stack:
        contestants = {}
        for name in (OVERLAP, WITHOUT, ASYNC):
            made: Orchestrator = stack.enter_context(make_orchestrator(spec, randomize=True))
            environments = WithoutOverlap(made) if name == WITHOUT else made
            rounds = _training(spec, environments, max(size // 2, 1) if name == ASYNC else None).rounds()
            warm = next(progress for progress in rounds if not progress.warming_up)
            _train_until(rounds, warm.steps + size * EPISODE)  # the first updates set things up
            contestants[name] = partial(_seconds_of_turn, rounds, size * EPISODE)
        times = take_turns(contestants, turns=amounts.turns)
    for name in (OVERLAP, ASYNC):
        yield beside(NAME, f"panda reach, {size * EPISODE} steps, {name}", times[name], "s", WITHOUT, times[WITHOUT])


def _seconds_of_turn(rounds: Iterator[Progress], steps: int, turn: int) -> float:
    """Seconds to train for `steps` more steps; two episodes of every environment are over before turn 0."""
    started = perf_counter()
    _train_until(rounds, steps * (turn + 3))
    return perf_counter() - started


def _train_until(rounds: Iterator[Progress], steps: int) -> None:
    next(progress for progress in rounds if progress.steps >= steps)


def balanced(amounts: Amounts, say: Callable[[str], object]) -> Spec:
    """A spec in which a round's one update costs about as much as its steps on this machine."""
    spec = _spec(min(8, amounts.environments))
    with make_orchestrator(spec, randomize=True) as environments:
        collecting = 1 / steps_per_second(environments, amounts.probe)
        training = _training(spec, environments, None)
        list(training.rounds())
        updates, started = 0, perf_counter()
        while updates == 0 or perf_counter() - started < amounts.probe:
            training.agent.learn(training.buffer.sample(spec.training.batch_size))
            updates += 1
        learning = (perf_counter() - started) / updates
    size = min(max(round(learning / collecting), 2), amounts.environments)
    say(f"a step takes {1e3 * collecting:.3f} ms, an update {1e3 * learning:.3f} ms: {size} environments")
    return _spec(size, replay_ratio=spec.training.batch_size / size, steps=10**9)


def _spec(environments: int, **training: float) -> Spec:
    """The overlap experiment's spec; the warm-up is one episode of each environment."""
    chosen = {"steps": EPISODE * environments, "warmup_episodes": environments, **training}
    layout = f"orchestrator={{processes: 1, environments: {environments}}}"
    return reach(layout, *(f"training.{name}={value}" for name, value in chosen.items()))


def _training(spec: Spec, environments: Orchestrator, at_least: int | None) -> Training:
    seeds = SeedTree(0)
    agent = make_agent(spec, environments.signature, seeds)
    buffer = make_buffer(spec, environments.signature, seeds, environments=environments.size, discount=agent.discount)
    return Training(environments, agent, buffer, spec.training, seeds, at_least)


def _until_success(seeds: Sequence[int], *, peers: bool, say: Callable[[str], object]) -> Iterator[Row]:
    """Seconds to the first test with .95 success at the end of its episodes; medians over the seeds."""

    def run(who: str, turn: int) -> Found:
        found = first_success(seeds[turn], peer=who == PEER)
        say(f"{who}: .95 success (end): {found.steps} steps, {found.training:.1f} s of training, {found.whole:.1f} s")
        return found

    if peers:
        tests = f"tests of {EPISODES} episodes every {INTERVAL} steps"
        say(f"{tests}; {PEER}: at most {PEER_STEPS:,} steps, settings: {PEER_RECIPE['source']}")
    runs = take_turns({who: partial(run, who) for who in ("karolos", *([PEER] if peers else []))}, turns=len(seeds))
    for what, column in (("training", "training"), ("start, imports and training", "whole")):
        case = f"panda reach until .95 success at the end, {what}"
        seconds = {who: [getattr(found, column) for found in founds] for who, founds in runs.items()}
        if peers:
            yield beside(NAME, case, seconds["karolos"], "s", PEER, seconds[PEER])
        else:
            yield Row(NAME, case, median(seconds["karolos"]), "s")
