"""karolos bench experts."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated

import typer

from karolos.errors import UsageError

from ..common import Json, rows
from .environment import Control

if TYPE_CHECKING:
    from karolos.benchmarks.experts import Case


def experts(
    pair: Annotated[
        list[str] | None,
        typer.Option(metavar="ROBOT/TASK", help="This pair only; may be repeated. All by default.", show_default=False),
    ] = None,
    episodes: Annotated[int, typer.Option(min=1, help="Seeded test episodes of each pair and policy.")] = 200,
    control: Annotated[Control | None, typer.Option(help="Control mode; the robot's default by default.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Root of the episodes' seeds.")] = 0,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes side by side. One per core by default.", show_default=False)
    ] = None,
    json: Json = False,
) -> None:
    """Success of the scripted expert with each robot and task, beside that of a random policy in the same episodes."""
    from karolos.benchmarks.experts import measure

    cases = _cases(pair or [], control.value if control else None)
    lines = []
    for row in measure(cases, episodes=episodes, seed=seed, jobs=jobs):
        print(f"{row.case}: {row.value:.3g}", file=sys.stderr)
        lines.append(row.dump())
        if json:
            rows(lines[-1:], json=True)
    if not json:
        rows(
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
    """Those named, which have to go together, or all that do."""
    from karolos.benchmarks.experts import Case, all_cases, check

    if not pairs:
        cases, refusals = all_cases(control)
        for refusal in refusals:
            print(f"left out: {refusal}", file=sys.stderr)
        return cases
    cases = []
    for text in pairs:
        robot, slash, task = text.partition("/")
        if not (robot and slash and task):
            raise UsageError(f"{text!r} is no pair", where="--pair", hint="write ROBOT/TASK, as in panda/reach")
        cases.append(Case(robot, task, control))
    for case in cases:
        check(case)
    return cases
