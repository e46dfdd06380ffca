"""`karolos test`: a run's saved policy under changed settings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .arguments import Checkpoint, Database, Json, OneRun, Runs, open_run
from .output import print_rows, print_table, success_row, warn


def transfer(
    run: OneRun,
    overrides: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[PATH=VALUE]...",
            help="Settings to change of the run's robot, task, environment, randomization or orchestrator, e.g. "
            "robot=ur5 task.object_mass=0.3",
        ),
    ] = None,
    episodes: Annotated[int | None, typer.Option(min=1, help="Episodes. Default: as in the run's own tests.")] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Root of the episodes' seeds. Default: that of the run's tests.")
    ] = None,
    checkpoint: Checkpoint = "best",
    randomize: Annotated[bool, typer.Option("--randomize", help="Randomize as in training.")] = False,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Test a run's saved policy under changed settings: another robot, other physics, randomization.

    The result is printed beside the run's own last test. It is also written to the run's folder (transfers.jsonl),
    and `karolos runs show` shows it.
    """
    folder = open_run(run, runs, database)
    from karolos.evaluation.transfer_test import transfer_test
    from karolos.records.results import TestCounts
    from karolos.report.tables import table_of_tests, transfers_table

    done = transfer_test(
        folder,
        overrides or (),
        checkpoint=checkpoint,
        episodes=episodes,
        seed=seed,
        randomize=randomize,
        on_failure=lambda failure: warn(f"{failure.error}; its episodes are played again"),
    )
    own = folder.tests()
    if json:
        last = {"steps": own[-1].steps, **success_row(TestCounts.of(own[-1]))} if own else None
        print_rows([{"run": folder.id, **done.row(), "own": last}], json=True)
        return
    print_table(transfers_table([done], title=folder.id))
    if own:
        print_table(table_of_tests([TestCounts.of(own[-1])], own[-1:], title="the run's own last test"))
