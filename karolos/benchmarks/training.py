"""What overlapping collection with learning saves, and how soon an agent can do something, beside a peer.

The first: a Panda learns to reach with as many updates as make learning as dear as collecting, in one worker process;
in lockstep, in lockstep without overlap (the loop waits for the environments before it learns), and asynchronously.
The second: seconds until a test finds .95 success on the same task, beside stable-baselines3's SAC with hindsight on
panda-gym; each in a process of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from statistics import median
from time import perf_counter

from ..agents.device import use_threads
from ..assembly import make_agent, make_buffer, make_orchestrator
from ..core import Array, FloatArray, Orchestrator, Received
from ..orchestrator.probe import steps_per_second
from ..seeding import SeedTree
from ..spec import Spec
from ..training import Training
from .end_to_end import PEER, first_success, reach, require_peer
from .row import Row

NAME = "training"
OVERLAP, WITHOUT, ASYNC = "lockstep", "lockstep without overlap", "async"


@dataclass(frozen=True)
class Amounts:
    """How much to measure."""

    steps: int = 6_000
    """Environment steps with learning, of each variant and repeat."""
    repeats: int = 3
    probe: float = 2.0
    """Seconds in which the speed of collecting and of learning is found out, each."""
    environments: int = 8
    seeds: tuple[int, ...] = (0,)
    """Of the runs from start to success; as many of the peer's."""


QUICK = Amounts(steps=80, repeats=1, probe=0.05, environments=2)


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
    """Seconds for the same number of steps and updates with and without overlap, and asynchronously; medians."""
    use_threads(1)
    spec = balanced(amounts, say)
    variants: dict[str, Callable[[Orchestrator], tuple[Orchestrator, int | None]]] = {
        OVERLAP: lambda environments: (environments, None),
        WITHOUT: lambda environments: (WithoutOverlap(environments), None),
        ASYNC: lambda environments: (environments, max(amounts.environments // 4, 1)),
    }
    times: dict[str, list[float]] = {name: [] for name in variants}
    for repeat in range(amounts.repeats):
        for name, vary in variants.items():
            times[name].append(_seconds(spec, amounts.steps, vary))
        say(f"repeat {repeat + 1}: " + ", ".join(f"{name} {found[-1]:.2f} s" for name, found in times.items()))
    ratios = {name: median(a / b for a, b in zip(times[name], times[WITHOUT], strict=True)) for name in variants}
    for name in (OVERLAP, ASYNC):
        case = f"panda reach, {amounts.steps} steps, {spec.training.replay_ratio:.3g} replay ratio, {name}"
        base = median(times[WITHOUT])
        # The ratio is the median of the pairs': a machine that others use too changes its speed between repeats.
        yield Row(NAME, case, ratios[name] * base, "s", WITHOUT, base)


def balanced(amounts: Amounts, say: Callable[[str], object]) -> Spec:
    """A spec by which learning costs about as much as collecting on this machine, as measured."""
    spec = _spec(amounts.environments)
    with make_orchestrator(spec, randomize=True) as environments:
        collecting = 1 / steps_per_second(environments, amounts.probe)
        training = _training(spec, environments, None)
        list(training.rounds())
        updates, started = 0, perf_counter()
        while updates == 0 or perf_counter() - started < amounts.probe:
            training.agent.learn(training.buffer.sample(spec.training.batch_size))
            updates += 1
        learning = (perf_counter() - started) / updates
    ratio = spec.training.batch_size * collecting / learning
    say(f"a step takes {1e3 * collecting:.3f} ms, an update {1e3 * learning:.3f} ms")
    return _spec(amounts.environments, replay_ratio=ratio, steps=10**9)


def _spec(environments: int, **training: float) -> Spec:
    """Of the overlap experiment; warm-up is one episode of each environment."""
    chosen = {"steps": 50 * environments, "warmup_episodes": environments, **training}
    layout = f"orchestrator={{processes: 1, environments: {environments}}}"
    return reach(layout, *(f"training.{name}={value}" for name, value in chosen.items()))


def _training(spec: Spec, environments: Orchestrator, at_least: int | None) -> Training:
    seeds = SeedTree(0)
    agent = make_agent(spec, environments.signature, seeds)
    buffer = make_buffer(spec, environments.signature, seeds, environments=environments.size, discount=agent.discount)
    return Training(environments, agent, buffer, spec.training, seeds, at_least)


def _seconds(spec: Spec, steps: int, vary: Callable[[Orchestrator], tuple[Orchestrator, int | None]]) -> float:
    """For so many steps after warm-up."""
    with make_orchestrator(spec, randomize=True) as made:
        environments, at_least = vary(made)
        rounds = _training(spec, environments, at_least).rounds()
        warm = next(progress for progress in rounds if not progress.warming_up)
        list(islice(rounds, 2))  # the first updates set things up
        started = perf_counter()
        end = next(progress for progress in rounds if progress.steps >= warm.steps + steps)
        elapsed = perf_counter() - started
        return elapsed * steps / (end.steps - warm.steps)


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
