"""`karolos bench experts`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from karolos.errors import UsageError

from ..arguments import Json
from ..output import print_rows, say
from .environment import Control

if TYPE_CHECKING:
    from karolos.benchmarks.experts import Case


def experts(
    pair: Annotated[
        list[str] | None,
        typer.Option(metavar="ROBOT/TASK", help="Only this pair; may be repeated. Default: all.", show_default=False),
    ] = None,
    episodes: Annotated[int, typer.Option(min=1, help="Seeded test episodes per pair and policy.")] = 200,
    control: Annotated[Control | None, typer.Option(help="Control mode. Default: that of the robot.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Root of the seeds of the episodes.")] = 0,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes at the same time. Default: one per core.", show_default=False)
    ] = None,
    json: Json = False,
) -> None:
    """Measure the success of the scripted expert per robot and task, beside a random policy in the same episodes."""
    from karolos.benchmarks.experts import measure

    cases = _cases(pair or [], control.value if control else None)
    lines = []
    for row in measure(cases, episodes=episodes, seed=seed, jobs=jobs):
        say(f"{row.case}: {row.value:.3g}")
        lines.append(row.dump())
        if json:
            print_rows(lines[-1:], json=True)
    if not json:
        print_rows(
            (
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
                for line in lines
            ),
            json=False,
        )


def _cases(pairs: list[str], control: str | None) -> list[Case]:
    """The named pairs, which must fit together, or all pairs that do."""
    from karolos.benchmarks.experts import Case, all_cases, check

    if not pairs:
        cases, refusals = all_cases(control)
        for refusal in refusals:
            say(f"left out: {refusal}")
        return cases
    cases = []
    for text in pairs:
        robot, slash, task = text.partition("/")
        if not (robot and slash and task):
            raise UsageError(f"{text!r} is not a pair", where="--pair", hint="write ROBOT/TASK, as in panda/reach")
        cases.append(Case(robot, task, control))
    for case in cases:
        check(case)
    return cases
