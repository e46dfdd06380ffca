"""`karolos bench`: how fast the parts are on this machine, beside a peer measured in the same run."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from karolos.errors import UsageError
from karolos.report.tables import Table

from .arguments import Json, Overrides
from .completion import complete_plugin
from .output import print_rows, print_table, say

if TYPE_CHECKING:
    from karolos.benchmarks.experts import Case
    from karolos.benchmarks.side_by_side import Row

app = typer.Typer(name="bench", help="Measure the speed of parts beside a peer in the same run.", no_args_is_help=True)
Robot = Annotated[str, typer.Option(metavar="NAME", help="Name of a robot.", autocompletion=complete_plugin("robot"))]
Task = Annotated[str, typer.Option(metavar="NAME", help="Name of a task.", autocompletion=complete_plugin("task"))]
Seconds = Annotated[float, typer.Option(min=0.1, help="Time for all measurements together.")]
Control = Literal["joint", "cartesian"]
Engine = Annotated[
    Literal["bullet", "mujoco"] | None, typer.Option(help="Physics engine. Default: bullet where it is installed.")
]
COLUMNS = ("benchmark", "case", "value", "unit", "peer", "peer_value", "ratio", "ratio_min", "ratio_max")
AGENT_COLUMNS = ("case", "steps", "episodes", "value", "unit", "peer", "peer_steps", "peer_value", "peer_settings")


@app.command()
def agents(
    overrides: Overrides = None,
    folder: Annotated[
        Path, typer.Option("--runs", metavar="FOLDER", help="Folder of the runs and of the table.")
    ] = Path("runs/bench"),
    only: Annotated[
        str | None, typer.Option(metavar="NAME,...", help="Beginnings of entries to run: pendulum,panda_reach sac.")
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Runs of each entry.")] = 5,
    quick: Annotated[bool, typer.Option("--quick", help="Toy tasks, which only show that everything runs.")] = False,
    peers: Annotated[bool, typer.Option("--peers", help="Run tuned stable-baselines3 too.")] = False,
    jobs: Annotated[int, typer.Option(min=1, help="Runs of an entry at the same time.")] = 1,
    json: Json = False,
) -> None:
    """Measure what each agent learns with each buffer over several seeds. Takes hours; a second call resumes.

    A figure is that of the last test. stable-baselines3 plays as many test episodes, on seeds of its own. It makes the
    same number of steps; in a second row it makes the number of steps that its settings are tuned for. The table so far
    is in the runs folder (agents.md, agents.json).
    """
    from karolos.benchmarks.agents import measure

    beginnings = () if only is None else tuple(part.strip() for part in only.split(","))
    results = measure(
        folder, overrides=overrides or (), only=beginnings, seeds=seeds, peers=peers, quick=quick, jobs=jobs, say=say
    )
    _print_measurements((row for result in results for row in result.rows()), json=json, columns=AGENT_COLUMNS)


@app.command()
def buffers(
    transitions: Annotated[int, typer.Option(min=1000, help="Transitions in each buffer.")] = 1_000_000,
    seconds: Seconds = 10.0,
    json: Json = False,
) -> None:
    """Measure the milliseconds to sample and to add, and the memory, of full replay buffers (pick-and-place)."""
    from karolos.benchmarks.buffers import measure

    _print_measurements(measure(transitions=transitions, seconds=seconds), json=json)


@app.command()
def environment(
    robot: Robot = "panda",
    task: Task = "reach",
    control: Annotated[Control | None, typer.Option(help="Only this control mode. Default: both.")] = None,
    engine: Engine = None,
    seconds: Seconds = 10.0,
    peers: Annotated[bool, typer.Option("--peers", help="Measure panda-gym too, if it is installed.")] = False,
    json: Json = False,
) -> None:
    """Measure steps per second of a robot with a task on one core, beside the bare physics of the same episodes."""
    from karolos.benchmarks.environment import measure, measure_panda_gym

    controls = ["joint", "cartesian"] if control is None else [control]
    if peers:
        rows = measure_panda_gym(seconds=seconds)
    else:
        rows = measure(robot, task, controls=controls, engine=engine, seconds=seconds)
    _print_measurements(rows, json=json)


@app.command()
def orchestrator(
    robot: Robot = "panda",
    task: Task = "reach",
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Box plots to write: FILE.svg, .pdf or .png.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Seconds, not minutes; the numbers mean little.")] = False,
    json: Json = False,
    figure: Annotated[Path | None, typer.Option(hidden=True)] = None,
) -> None:
    """Measure resets and steps over processes and threads beside gymnasium's vector environments; advise settings."""
    from karolos.benchmarks.orchestrator import QUICK, Amounts, measure
    from karolos.report.figures import check_format, write_box_plots

    figure = out or figure
    if figure is not None:
        check_format(figure)
    report = measure(robot, task, QUICK if quick else Amounts())
    _print_measurements(report.rows, json=json)
    for line in report.advice:
        say(line)
    if figure is not None:
        write_box_plots(report.plots, figure)
        say(f"wrote the box plots into {figure}")


@app.command()
def experts(
    pair: Annotated[
        list[str] | None, typer.Option(metavar="ROBOT/TASK", help="Only this pair; may be repeated. Default: all.")
    ] = None,
    episodes: Annotated[int, typer.Option(min=1, help="Seeded test episodes per pair and policy.")] = 200,
    control: Annotated[Control | None, typer.Option(help="Control mode. Default: that of the robot.")] = None,
    engine: Engine = None,
    seed: Annotated[int, typer.Option(min=0, help="Root of the seeds of the episodes.")] = 0,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes at the same time. Default: one per core.")] = None,
    json: Json = False,
) -> None:
    """Measure the success of the scripted expert per robot and task, beside a random policy in the same episodes."""
    from karolos.benchmarks.experts import measure

    shown = []
    for row in measure(_cases(pair or [], control, engine), episodes=episodes, seed=seed, jobs=jobs):
        say(f"{row.case}: {row.value:.3g}")
        line = row.dump()
        if json:
            print_rows([line], json=True)
        shown.append(
            {
                "pair": line["case"],
                "end": line["value"],
                "interval": f"{line['low']:.3f} .. {line['high']:.3f}",
                "any": line["any"],
                "steps": line["steps"],
                "random": line["peer_value"],
                "random_interval": f"{line['peer_low']:.3f} .. {line['peer_high']:.3f}",
                "episodes": line["episodes"],
            }
        )
    if not json:
        print_rows(shown, json=False)


@app.command()
def store(
    runs: Annotated[int, typer.Option(min=16, help="Runs in the database.")] = 10_000,
    tests: Annotated[int, typer.Option(min=1, help="Tests per run.")] = 50,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes per test.")] = 100,
    writers: Annotated[int, typer.Option(min=1, help="Processes that write at the same time.")] = 16,
    database: Annotated[
        str | None,
        typer.Option(metavar="URL", help="URL of an empty database to fill and measure. Default: a SQLite file."),
    ] = None,
    json: Json = False,
) -> None:
    """Measure the seconds to rebuild, check and query the results database, and how fast many processes write to it."""
    from karolos.benchmarks.store import measure

    rows = measure(runs=runs, tests=tests, episodes=episodes, writers=writers, database=database)
    _print_measurements(rows, json=json)


@app.command()
def training(
    seeds: Annotated[int, typer.Option(min=1, help="Runs from start to success, and the same number of the peer.")] = 1,
    quick: Annotated[
        bool, typer.Option("--quick", help="Seconds, not minutes, and no run to success; the numbers mean little.")
    ] = False,
    peers: Annotated[
        bool, typer.Option("--peers", help="Measure stable-baselines3 on panda-gym too, if installed.")
    ] = False,
    json: Json = False,
) -> None:
    """Measure what learning while environments step saves, and the seconds until a Panda has learned to reach."""
    from karolos.benchmarks.training import QUICK, Amounts, measure

    amounts = QUICK if quick else Amounts(seeds=tuple(range(seeds)))
    _print_measurements(measure(amounts, peers=peers, end_to_end=not quick, say=say), json=json)


@app.command()
def updates(
    threads: Annotated[str, typer.Option(metavar="N,...", help="Numbers of CPU threads to measure with: 1,2.")] = "1",
    only: Annotated[
        str | None,
        typer.Option(metavar="NAME,...", help="Names of agents: sac,td3. Default: all with a replay buffer."),
    ] = None,
    device: Annotated[Literal["auto", "cpu", "cuda"], typer.Option(help="Where the agents learn.")] = "cpu",
    seconds: Annotated[float, typer.Option(min=0.1, help="Time per number of threads.")] = 20.0,
    peers: Annotated[bool, typer.Option("--peers", help="Measure stable-baselines3 and SBX too.")] = False,
    json: Json = False,
) -> None:
    """Measure gradient updates per second: two hidden layers of 256, batches of 256, 20 inputs, 4 actions."""
    from karolos.agents.device import resolve_device
    from karolos.benchmarks.updates import AGENTS, measure

    names = AGENTS if only is None else tuple(only.split(","))
    for name in names:
        if name not in AGENTS:
            hint = f"one of {', '.join(AGENTS)}"
            raise UsageError(f"no benchmark of updates for {name!r}", where="--only", hint=hint)
    rows = measure(agents=names, threads=_numbers(threads), device=resolve_device(device), peers=peers, seconds=seconds)
    _print_measurements(rows, json=json)


def _print_measurements(rows: Iterable[Row], *, json: bool, columns: Sequence[str] = COLUMNS) -> None:
    """Print a table, or one JSON object per measurement as soon as it is made."""
    measured = (row.dump() for row in rows)
    if json:
        print_rows(measured, json=True)
    else:
        print_table(Table(columns, [[_cell(row[column]) for column in columns] for row in measured]))


def _cell(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:,.0f}" if value >= 1000 else f"{value:.3g}"
    return str(value)


def _cases(pairs: list[str], control: str | None, engine: Literal["bullet", "mujoco"] | None) -> list[Case]:
    """The named pairs, which must fit together, or all pairs that do."""
    from karolos.benchmarks.experts import Case, all_cases, check

    if not pairs:
        cases, refusals = all_cases(control, engine)
        for refusal in refusals:
            say(f"left out: {refusal}")
        return cases
    cases = []
    for text in pairs:
        robot, slash, task = text.partition("/")
        if not (robot and slash and task):
            raise UsageError(f"{text!r} is not a pair", where="--pair", hint="write ROBOT/TASK, as in panda/reach")
        cases.append(Case(robot, task, control, engine))
    for case in cases:
        check(case)
    return cases


def _numbers(text: str) -> list[int]:
    """The numbers in a text such as "1,2"."""
    parts = text.split(",")
    if not all(part.strip().isdecimal() and int(part) > 0 for part in parts):
        raise UsageError(f"{text!r} is not a list of numbers of threads", where="--threads", hint="write 1,2")
    return [int(part) for part in parts]
