"""`karolos test`: a run's saved policy under changed settings."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from karolos.report.terminal import clean

from .common import RUN_HELP, Database, Json, Runs, print_rich, rows
from .selection import check_checkpoint, open_run

if TYPE_CHECKING:
    from karolos.core import Failure
    from karolos.records.results import TestResult


def transfer(
    run: Annotated[str, typer.Argument(metavar="RUN", help=RUN_HELP, show_default=False)],
    overrides: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[PATH=VALUE]...",
            help="What to change of the run's robot, task, environment, randomization or orchestrator: robot=ur5 "
            "task.object_mass=0.3",
            show_default=False,
        ),
    ] = None,
    episodes: Annotated[
        int | None, typer.Option(min=1, help="Episodes to play; as in the run's own tests.", show_default=False)
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Root of the episodes' seeds; that of the run's own tests.", show_default=False),
    ] = None,
    checkpoint: Annotated[str, typer.Option(help="Which checkpoint to test: best or last.")] = "best",
    randomize: Annotated[
        bool, typer.Option("--randomize", help="Draw what the spec's randomization says, as in training.")
    ] = False,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Test a run's saved policy under changed settings: another robot, other physics, randomization.

    The result is kept in the run's folder (transfers.jsonl), shown by `karolos runs show`, and printed beside the
    run's own last test.
    """
    check_checkpoint(checkpoint)
    folder = open_run(run, runs, database)
    from karolos.evaluation.transfer_test import transfer_test

    done = transfer_test(
        folder,
        overrides or (),
        checkpoint=checkpoint,
        episodes=episodes,
        seed=seed,
        randomize=randomize,
        on_failure=_tell,
    )
    own = folder.tests()
    if json:
        rows([{"run": folder.id, **done.row(), "own": _own(own[-1]) if own else None}], json=True)
        return
    from karolos.records.results import TestCounts
    from karolos.report.tables import table_of_tests, transfers_table

    print_rich(transfers_table([done], title=folder.id))
    if own:
        print_rich(table_of_tests([TestCounts.of(own[-1])], own[-1:], title="the run's own last test"))


def _own(result: TestResult) -> dict[str, Any]:
    from karolos.statistics.intervals import wilson

    return {
        "steps": result.steps,
        "episodes": result.episodes,
        "success_any": result.success_any,
        "success_any_interval": wilson(sum(result.any), result.episodes),
        "success_end": result.success_end,
        "success_end_interval": wilson(sum(result.end), result.episodes),
    }


def _tell(failure: Failure) -> None:
    print(f"warning: {clean(str(failure.error))}; its episodes are played again", file=sys.stderr)
