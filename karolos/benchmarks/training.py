"""What overlapping collection with learning saves, and how soon an agent can do something, beside a peer.

The first: a Panda learns to reach with one update per round, and as many environments in one worker process as make a
round's steps as dear as its update; in lockstep, in lockstep without overlap (the loop waits for the environments
before it learns), and asynchronously. They take turns of one episode, many times over; ratios are medians of the
turns', because a machine is never alone.
The second: seconds until a test finds .95 success on the same task, beside stable-baselines3's SAC with hindsight on
panda-gym; each in a process of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from statistics import median
from time import perf_counter

from ..agents.device import use_threads
from ..core import Array, FloatArray, Orchestrator, Received
from ..core.seeding import SeedTree
from ..orchestrator.probe import steps_per_second
from ..spec import Spec
from ..training.assembly import make_agent, make_buffer, make_orchestrator
from ..training.training import Progress, Training
from .end_to_end import PEER, first_success, reach, require_peer
from .row import Row

NAME = "training"
EPISODE = 50
"""Steps of an episode of reaching."""
OVERLAP, WITHOUT, ASYNC = "lockstep", "lockstep without overlap", "async"


@dataclass(frozen=True)
class Amounts:
    """How much to measure."""

    turns: int = 24
    """Episodes of every environment, with learning, in each variant."""
    probe: float = 2.0
    """Seconds in which the speed of collecting and of learning is found out, each."""
    environments: int = 256
    """At most."""
    seeds: tuple[int, ...] = (0,)
    """Of the runs from start to success; as many of the peer's."""


QUICK = Amounts(turns=2, probe=0.05, environments=2)


class WithoutOverlap(Orchestrator):
    """Another's environments; but a command waits until it is carried out, so that nothing happens meanwhile.

    Gives the same results as the other in lockstep, only later.
    """

    def __init__(self, other: Orchestrator) -> None:
        self._other = other
        self.signature, self.size = other.signature, other.size
        self._received: Received | None = None

    def reset(self, environments: Sequence[int] | Array, seeds: Sequence[int]) -> None:
        self._other.reset(environments, seeds)
        self._received = self._other.receive()

    def step(self, environments: Sequence[int] | Array, actions: FloatArray, *, updates: int = 0) -> None:
        self._other.step(environments, actions, updates=updates)
        self._received = self._other.receive()

    def receive(self, at_least: int | None = None) -> Received:
        received, self._received = self._received, None
        return self._other.receive(at_least) if received is None else received

    def parameters(self, environments: Sequence[int] | Array) -> FloatArray:
        return self._other.parameters(environments)

    def close(self) -> None:
        self._other.close()


def measure(
    amounts: Amounts | None = None,
    *,
    peers: bool = False,
    end_to_end: bool = True,
    say: Callable[[str], object] = print,
) -> Iterator[Row]:
    """The rows, each when it is known.

    Args:
        amounts: how much.
        peers: also train the peer.
        end_to_end: also the runs from start to success.
        say: is told what each run found.

    Raises:
        MachineError: peers asked for and not installed.
        RunError: a run from start to success failed.
    """
    amounts = amounts or Amounts()
    if peers:
        require_peer()
    yield from overlap(amounts, say)
    if end_to_end:
        yield from _sooner(amounts.seeds, peers=peers, say=say)


def overlap(amounts: Amounts, say: Callable[[str], object]) -> Iterator[Row]:
    """Seconds for the same number of steps and updates with and without overlap, and asynchronously."""
    use_threads(1)
    spec = balanced(amounts, say)
    size = spec.orchestrator.settings.size
    variants: dict[str, tuple[Callable[[Orchestrator], Orchestrator], int | None]] = {
        OVERLAP: (lambda environments: environments, None),
        WITHOUT: (WithoutOverlap, None),
        ASYNC: (lambda environments: environments, max(size // 2, 1)),
    }
    times: dict[str, list[float]] = {name: [] for name in variants}
    with ExitStack() as stack:
        rounds = {}
        for name, (vary, at_least) in variants.items():
            environments = vary(stack.enter_context(make_orchestrator(spec, randomize=True)))
            rounds[name] = _training(spec, environments, at_least).rounds()
            warm = next(progress for progress in rounds[name] if not progress.warming_up)
            _turn(rounds[name], warm.steps + size * EPISODE)  # the first updates set things up
        for turn in range(2, amounts.turns + 2):
            for name, found in times.items():
                started = perf_counter()
                _turn(rounds[name], size * EPISODE * (turn + 1))
                found.append(perf_counter() - started)
    base = median(times[WITHOUT])
    for name in (OVERLAP, ASYNC):
        ratio = median(own / without for own, without in zip(times[name], times[WITHOUT], strict=True))
        yield Row(NAME, f"panda reach, {size * EPISODE} steps, {name}", ratio * base, "s", WITHOUT, base)


def _turn(rounds: Iterator[Progress], steps: int) -> None:
    """Train until so many steps have been taken."""
    next(progress for progress in rounds if progress.steps >= steps)


def balanced(amounts: Amounts, say: Callable[[str], object]) -> Spec:
    """A spec by which a round's one update costs about as much as its steps on this machine, as measured."""
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
    """Of the overlap experiment; warm-up is one episode of each environment."""
    chosen = {"steps": EPISODE * environments, "warmup_episodes": environments, **training}
    layout = f"orchestrator={{processes: 1, environments: {environments}}}"
    return reach(layout, *(f"training.{name}={value}" for name, value in chosen.items()))


def _training(spec: Spec, environments: Orchestrator, at_least: int | None) -> Training:
    seeds = SeedTree(0)
    agent = make_agent(spec, environments.signature, seeds)
    buffer = make_buffer(spec, environments.signature, seeds, environments=environments.size, discount=agent.discount)
    return Training(environments, agent, buffer, spec.training, seeds, at_least)


def _sooner(seeds: Sequence[int], *, peers: bool, say: Callable[[str], object]) -> Iterator[Row]:
    """Seconds to the first test with .95 success; medians over the seeds."""
    ours = [first_success(seed) for seed in seeds]
    for found in ours:
        say(f"karolos: .95 success after {found.steps} steps, {found.training:.1f} s of training, {found.whole:.1f} s")
    theirs = [first_success(seed, peer=True) for seed in seeds] if peers else []
    for found in theirs:
        say(f"{PEER}: .95 success after {found.steps} steps, {found.training:.1f} s of training, {found.whole:.1f} s")
    for what, read in (
        ("training", lambda found: found.training),
        ("start, imports and training", lambda found: found.whole),
    ):
        rival = median(map(read, theirs)) if theirs else None
        case = f"panda reach until .95 success, {what}"
        yield Row(NAME, case, median(map(read, ours)), "s", PEER if theirs else None, rival)
