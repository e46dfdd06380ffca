"""What agents learn: one table over well-known tasks, every agent with every buffer that goes with it, beside a peer.

Each entry is a spec of `karolos/benchmarks/specs` and a target. Runs are ordinary runs in a runs folder. Seeds that are
finished there are not run again: the table takes hours and may be interrupted at any time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.resources import as_file, files
from pathlib import Path
from statistics import fmean

from ..errors import RunError, UsageError
from ..experiment.events import Listener
from ..files import write_json, write_whole
from ..launchers.experiment import Experiment
from ..records import RunFolder
from ..registry import alternatives, names
from ..spec import Spec, load_spec
from . import agent_peers
from .side_by_side import Row

PRIORITY = ("buffer.name=priority",)
QUICK = (
    "training.steps=400",
    "testing.interval=400",
    "testing.episodes=2",
    "testing.final_episodes=0",
    "orchestrator.processes=0",
    "agent.hidden=[16, 16]",
)
"""Overrides that make every entry a toy, which shows only that it runs."""


@dataclass(frozen=True)
class TableEntry:
    """A row of the table.

    Args:
        spec: name of a file in `specs`.
        unit: figure of the last test: mean "return", or the share of episodes with "success" at their end.
        target: the least mean over the seeds, or the largest where `fails`.
        overrides: applied to the spec.
        fails: whether the entry shows that this setting does not learn.
    """

    spec: str
    unit: str
    target: float
    overrides: tuple[str, ...] = ()
    fails: bool = False

    def met(self, value: float) -> bool:
        return value <= self.target if self.fails else value >= self.target


def _entries() -> dict[str, TableEntry]:
    entries = {}
    for task, unit, target, off_policy in (
        ("cartpole", "return", 475, ("dqn",)),
        ("pendulum", "return", -200, ("sac", "ddpg", "td3")),
        ("bit_flip", "success", 0.95, ("dqn",)),
        ("panda_reach", "success", 0.95, ("sac", "ddpg", "td3", "dqn")),
    ):
        for agent in off_policy:
            spec = task if task == "bit_flip" else f"{task}_{agent}"
            entries[f"{task} {agent}"] = TableEntry(spec, unit, target)
            entries[f"{task} {agent} priority"] = TableEntry(spec, unit, target, PRIORITY)
        if task == "bit_flip":
            without = ("buffer.hindsight=null",)
            entries["bit_flip dqn without hindsight"] = TableEntry(task, unit, 0.05, without, fails=True)
        else:
            entries[f"{task} ppo"] = TableEntry(f"{task}_ppo", unit, target)
    return entries


ENTRIES = _entries()


@dataclass(frozen=True)
class AgentRow(Row):
    """A measurement after `steps` environment steps, over as many test episodes as those of the peer."""

    steps: int = 0
    episodes: int = 0
    peer_steps: int | None = None
    peer_settings: str | None = None


@dataclass(frozen=True)
class Result:
    """One entry of the table: the figure of each seed, and of the peer's seeds by its number of steps."""

    case: str
    unit: str
    steps: int
    episodes: int
    """Of the test that the figures are of."""
    target: float
    values: tuple[float, ...]
    met: bool
    peer_values: Mapping[int, Sequence[float]]
    """Empty where there is no peer."""
    peer_settings: str | None = None
    """Their source."""

    def rows(self) -> list[AgentRow]:
        """One row for each number of the peer's steps, or one without a peer."""
        row = AgentRow("agents", self.case, fmean(self.values), self.unit, steps=self.steps, episodes=self.episodes)
        return [
            replace(
                row,
                peer=agent_peers.PEER,
                peer_value=fmean(values),
                peer_steps=steps,
                peer_settings=self.peer_settings,
            )
            for steps, values in self.peer_values.items()
        ] or [row]


def measure(  # noqa: PLR0913  (options by keyword)
    folder: Path,
    *,
    overrides: Sequence[str] = (),
    only: Sequence[str] = (),
    seeds: int = 5,
    peers: bool = False,
    quick: bool = False,
    jobs: int = 1,
    say: Callable[[str], None] = print,
    listener: Listener | None = None,
) -> Iterator[Result]:
    """The rows of the table, each when its last seed has ended; `folder` holds the table so far (agents.md, .json).

    Args:
        folder: runs folder; runs that are finished there are not run again.
        overrides: of every spec, PATH=VALUE.
        only: entries whose names begin with one of these; all by default.
        seeds: number of seeds of each entry: 0, 1, ...
        peers: also train stable-baselines3, where it has the algorithm: for the same number of steps, and for the
            number of steps that its settings are tuned for.
        quick: toys instead.
        jobs: seeds that run at the same time.
        say: receives a line with each seed's figure.
        listener: receives the runs' events.

    Raises:
        UsageError: `only` matches no entry; peers are requested together with overrides.
        SpecError: an override does not fit a chosen entry.
        MachineError: peers are requested and not installed.
        RunError: a run failed.
    """
    if peers and overrides:  # the peer's numbers are stored by name, steps and seed
        raise UsageError(
            "the peer is trained on the entries as they are", where="--peers", hint="leave out --peers or the overrides"
        )
    if peers:
        agent_peers.require()
    results = []
    for case in chosen(only):
        entry = ENTRIES[case]
        spec = entry_spec(entry, overrides, quick=quick)
        spec = spec.model_copy(update={"seeds": tuple(range(seeds))})
        values = _values(spec, entry.unit, folder, jobs, listener)
        numbers = agent_peers.numbers_of_steps(entry.spec, spec) if peers and not entry.fails else ()
        rivals: dict[int, list[float]] = {steps: [] for steps in numbers[: 1 if quick else None]}
        for seed, value in enumerate(values):
            say(f"{case}, seed {seed}: {value:.4g}")
            for steps, figures in rivals.items():
                figures.append(agent_peers.value(entry.spec, spec, steps, seed, entry.unit, folder))
                say(f"{case}, seed {seed}, {agent_peers.PEER} after {steps:,} steps: {figures[-1]:.4g}")
        results.append(
            Result(
                case,
                entry.unit,
                spec.training.steps,
                spec.testing.episodes,
                entry.target,
                tuple(values),
                entry.met(fmean(values)),
                rivals,
                agent_peers.RECIPES[entry.spec]["source"] if rivals else None,
            )
        )
        _write(folder, results)
        yield results[-1]


def chosen(only: Sequence[str]) -> list[str]:
    """Entries whose names begin with one of `only` and whose agent is installed.

    Raises UsageError where no name begins so.
    """
    for start in only:
        if not any(case.startswith(start) for case in ENTRIES):
            raise UsageError(f"no entry begins with {start!r}", where="--only", hint=alternatives(start, ENTRIES))
    agents = names("agents")
    return [
        case
        for case in ENTRIES
        if case.split()[1] in agents and (not only or any(case.startswith(start) for start in only))
    ]


def entry_spec(entry: TableEntry, overrides: Sequence[str] = (), *, quick: bool = False) -> Spec:
    """The spec of an entry, from the package's own files. Raises SpecError where an override does not fit."""
    with as_file(files(__package__) / "specs") as folder:
        return load_spec(folder / f"{entry.spec}.yaml", (*entry.overrides, *(QUICK if quick else ()), *overrides))


def _values(spec: Spec, unit: str, folder: Path, jobs: int, listener: Listener | None) -> list[float]:
    """The figure of each seed's last test; a seed is run unless its finished run is in `folder`."""
    outcome = Experiment(spec).run(folder, jobs=jobs, existing="resume", listener=listener)
    if outcome.exit_code:
        raise RunError(f"{spec.name} was stopped", hint="the same command continues the table")
    tests = [RunFolder.open(run.folder).tests()[-1] for run in outcome.runs]
    return [fmean(test.returns) if unit == "return" else test.success_end for test in tests]


def _write(folder: Path, results: Sequence[Result]) -> None:
    write_json(folder / "agents.json", {"rows": [asdict(result) for result in results]})
    lines = [
        "| case | steps | seeds | episodes | mean | each seed | target | met | "
        f"{agent_peers.PEER}, after its steps | its settings |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for result in results:
        fails = ENTRIES[result.case].fails
        rivals = [f"{fmean(each):.4g} after {steps:,}: {_each(each)}" for steps, each in result.peer_values.items()]
        cells = (
            result.case,
            f"{result.steps:,}",
            str(len(result.values)),
            str(result.episodes),
            f"{fmean(result.values):.4g} ({result.unit})",
            _each(result.values),
            f"{'<=' if fails else '>='} {result.target:g}",
            "yes" if result.met else "no",
            rivals[0] if rivals else "-",
            result.peer_settings or "-",
        )
        lines.append(f"| {' | '.join(cells)} |")
        lines += [f"| {result.case} |{' - |' * 7} {rival} | {result.peer_settings} |" for rival in rivals[1:]]
    write_whole(folder / "agents.md", "\n".join(lines) + "\n")


def _each(values: Sequence[float]) -> str:
    return " ".join(f"{value:.4g}" for value in values)
