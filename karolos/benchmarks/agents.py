"""What agents learn: one table over well-known tasks, every agent with every buffer that goes with it, beside a peer.

Each entry is a spec of `karolos/benchmarks/specs` and what it has to reach. Runs are ordinary runs in a runs folder. A
seed that is finished there is not run again, so that a table which takes hours may be broken off at any time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from importlib.resources import as_file, files
from pathlib import Path
from statistics import fmean

from ..errors import RunError, UsageError
from ..experiment.events import Listener
from ..experiment.experiment import Experiment
from ..files import write_json, write_whole
from ..records import RunFolder, scan
from ..registry import alternatives, names
from ..spec import Spec, load_spec
from . import agent_peers
from .row import Row

PRIORITY = ("buffer.name=priority",)
QUICK = (
    "training.steps=400",
    "testing.interval=400",
    "testing.episodes=2",
    "orchestrator.processes=0",
    "agent.hidden=[16, 16]",
)
"""Overrides that make of every entry a toy that proves nothing but that it runs."""


@dataclass(frozen=True)
class Entry:
    """A row of the table.

    Args:
        spec: name of a file in `specs`.
        unit: what the last test is judged by: mean "return", or the share of episodes with "success" on any step.
        target: what the mean over the seeds should be at least, or at most where `fails`.
        overrides: laid over the spec.
        fails: whether it is there to show that it cannot be learned this way.
    """

    spec: str
    unit: str
    target: float
    overrides: tuple[str, ...] = ()
    fails: bool = False

    def met(self, value: float) -> bool:
        return value <= self.target if self.fails else value >= self.target


def _entries() -> dict[str, Entry]:
    found = {
        "cartpole dqn": Entry("cartpole_dqn", "return", 475),
        "cartpole dqn priority": Entry("cartpole_dqn", "return", 475, PRIORITY),
        "cartpole ppo": Entry("cartpole_ppo", "return", 475),
    }
    for agent in ("sac", "ddpg", "td3"):
        found[f"pendulum {agent}"] = Entry(f"pendulum_{agent}", "return", -200)
        found[f"pendulum {agent} priority"] = Entry(f"pendulum_{agent}", "return", -200, PRIORITY)
    found["pendulum ppo"] = Entry("pendulum_ppo", "return", -200)
    found["bit_flip dqn"] = Entry("bit_flip", "success", 0.95)
    found["bit_flip dqn priority"] = Entry("bit_flip", "success", 0.95, PRIORITY)
    found["bit_flip dqn without hindsight"] = Entry("bit_flip", "success", 0.05, ("buffer.hindsight=null",), fails=True)
    for agent in ("sac", "ddpg", "td3", "dqn"):
        found[f"panda_reach {agent}"] = Entry(f"panda_reach_{agent}", "success", 0.95)
        found[f"panda_reach {agent} priority"] = Entry(f"panda_reach_{agent}", "success", 0.95, PRIORITY)
    found["panda_reach ppo"] = Entry("panda_reach_ppo", "success", 0.95)
    return found


ENTRIES = _entries()


@dataclass(frozen=True)
class Result:
    """One row: what each seed reached, in the order of the seeds, and what the peer did; empty where there is none."""

    case: str
    unit: str
    steps: int
    target: float
    values: tuple[float, ...]
    met: bool
    peer_values: tuple[float, ...] = ()

    def row(self) -> Row:
        rival = fmean(self.peer_values) if self.peer_values else None
        peer = None if rival is None else agent_peers.PEER
        return Row("agents", self.case, fmean(self.values), self.unit, peer, rival)


def measure(
    folder: Path,
    *,
    overrides: Sequence[str] = (),
    only: Sequence[str] = (),
    seeds: int = 5,
    peers: bool = False,
    quick: bool = False,
    say: Callable[[str], None] = print,
    listener: Listener | None = None,
) -> Iterator[Result]:
    """The rows of the table, each when its last seed has ended; the table so far lies in `folder`, agents.md and .json.

    Args:
        folder: runs folder; what is finished there is not run again.
        overrides: of every spec, PATH=VALUE.
        only: entries whose names begin with one of these; all by default.
        seeds: how many of each: 0, 1, ...
        peers: also train stable-baselines3 for the same number of steps, where it has the algorithm.
        quick: toys instead.
        say: is told what each seed reached.
        listener: hears the runs' events.

    Raises:
        UsageError: no entry has such a name; peers asked for with overrides.
        SpecError: an override does not fit an entry that is chosen.
        MachineError: peers asked for and not installed.
        RunError: a run failed.
    """
    if peers and overrides:  # its numbers are kept by name, steps and seed
        raise UsageError(
            "the peer is trained on the entries as they are", where="--peers", hint="leave out --peers or the overrides"
        )
    if peers:
        agent_peers.require()
    results = []
    for case in chosen(only):
        entry = ENTRIES[case]
        spec = entry_spec(entry, overrides, quick=quick)
        values, rivals = [], []
        for seed in range(seeds):
            values.append(_value(spec, seed, entry.unit, folder, listener))
            say(f"{case}, seed {seed}: {values[-1]:.4g}")
            beside = peers and not entry.fails
            rival = agent_peers.value(entry.spec, spec, seed, entry.unit, folder) if beside else None
            if rival is not None:
                rivals.append(rival)
                say(f"{case}, seed {seed}, {agent_peers.PEER}: {rival:.4g}")
        met = entry.met(fmean(values))
        results.append(Result(case, entry.unit, spec.training.steps, entry.target, tuple(values), met, tuple(rivals)))
        _write(folder, results)
        yield results[-1]


def chosen(only: Sequence[str]) -> list[str]:
    """The entries whose names begin so and whose agent is installed. Raises UsageError where none does."""
    for start in only:
        if not any(case.startswith(start) for case in ENTRIES):
            raise UsageError(f"no entry begins with {start!r}", where="--only", hint=alternatives(start, ENTRIES))
    agents = names("agents")
    return [
        case
        for case in ENTRIES
        if case.split()[1] in agents and (not only or any(case.startswith(start) for start in only))
    ]


def entry_spec(entry: Entry, overrides: Sequence[str] = (), *, quick: bool = False) -> Spec:
    """The spec of an entry, from the package's own files. Raises SpecError where an override does not fit."""
    with as_file(files(__package__) / "specs") as folder:
        return load_spec(folder / f"{entry.spec}.yaml", (*entry.overrides, *(QUICK if quick else ()), *overrides))


def _value(spec: Spec, seed: int, unit: str, folder: Path, listener: Listener | None) -> float:
    """What this seed's last test found; the run is made unless it is there."""
    found = _finished(spec, seed, folder)
    if found is None:
        one = Spec.from_dict({**spec.dump(), "seeds": [seed]})
        Experiment(one).run(folder, listener=listener)
        found = _finished(spec, seed, folder)
    if found is None:
        raise RunError(f"{spec.name} with seed {seed} was stopped", hint="the same command goes on where it ended")
    last = found.tests()[-1]
    return fmean(last.returns) if unit == "return" else last.success_any


def _finished(spec: Spec, seed: int, folder: Path) -> RunFolder | None:
    for run in scan(folder, f"{spec.name}-s{seed}-*"):
        if isinstance(run, RunError):
            continue
        summary = run.summary()
        if summary.state == "finished" and summary.experiment == spec.hash() and summary.seed == seed:
            return run
    return None


def _write(folder: Path, results: Sequence[Result]) -> None:
    write_json(folder / "agents.json", {"rows": [asdict(result) for result in results]})
    lines = [
        "| case | steps | seeds | mean | each seed | target | met | " + f"{agent_peers.PEER} |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for result in results:
        fails = ENTRIES[result.case].fails
        rival = f"{fmean(result.peer_values):.4g}: {_each(result.peer_values)}" if result.peer_values else "-"
        cells = (
            result.case,
            f"{result.steps:,}",
            str(len(result.values)),
            f"{fmean(result.values):.4g} ({result.unit})",
            _each(result.values),
            f"{'<=' if fails else '>='} {result.target:g}",
            "yes" if result.met else "no",
            rival,
        )
        lines.append(f"| {' | '.join(cells)} |")
    write_whole(folder / "agents.md", "\n".join(lines) + "\n")


def _each(values: Sequence[float]) -> str:
    return " ".join(f"{value:.4g}" for value in values)
