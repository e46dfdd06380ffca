"""`karolos test`: a run's saved policy under changed settings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from karolos.errors import UsageError

from .arguments import Changes, Checkpoint, Database, Json, PolicyOrSpec, Runs, chosen_checkpoint, open_run
from .output import print_rows, print_table, say, warn


def zero_shot(
    run: PolicyOrSpec,
    overrides: Changes = None,
    episodes: Annotated[int | None, typer.Option(min=1, help="Episodes. Default: as in the run's final test.")] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Root of the episodes' seeds. Default: that of the run's final test.")
    ] = None,
    checkpoint: Checkpoint = None,
    expert: Annotated[bool, typer.Option("--expert", help="Test the expert of a spec's task instead.")] = False,
    randomize: Annotated[bool, typer.Option("--randomize", help="Randomize as in training.")] = False,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Test a run's saved policy under changed settings: another robot, other physics, randomization.

    The same policy's success on the same episodes without the changes is printed beside it. By default these are the
    episodes of the run's final test, on which no policy was chosen. The result is also written to the run's folder
    (transfers.jsonl), and `karolos runs show` shows it. With --expert the scripted policy of a spec's task is tested.
    """
    if expert:
        if randomize or checkpoint:
            option = "--randomize" if randomize else "--checkpoint"
            raise UsageError(f"--expert takes no {option}", hint="it plays test episodes, and has no checkpoints")
        _score_expert(Path(run), overrides or (), episodes, seed, json=json)
        return
    folder = open_run(run, runs, database)
    from karolos.evaluation.zero_shot import zero_shot_test
    from karolos.report.tables import measures_table, transfers_table

    done = zero_shot_test(
        folder,
        overrides or (),
        checkpoint=chosen_checkpoint(folder, checkpoint),
        episodes=episodes,
        seed=seed,
        randomize=randomize,
        on_warning=warn,
    )
    if json:
        print_rows([{"run": folder.id, **done.changed_row()}], json=True)
        return
    print_table(transfers_table([done], title=folder.id))
    if done.measures:
        print_table(measures_table(done.measures, "measures"))
    unused = "" if seed is not None else ", on which no policy was chosen"
    say(f"{done.episodes} episodes from seed {done.seed}{unused}")


def _score_expert(path: Path, overrides: Sequence[str], episodes: int | None, seed: int | None, *, json: bool) -> None:
    """Print the success of the expert of a spec's task on the episodes of its final test, or on those asked for."""
    from karolos.environments.build import used
    from karolos.evaluation.playing import FirstSuccesses, evaluate
    from karolos.evaluation.policies import load_expert
    from karolos.report.tables import heading
    from karolos.specification import load_spec
    from karolos.statistics.intervals import wilson

    spec = load_spec(path, overrides)
    testing = spec.testing
    seed = testing.final_seed if seed is None else seed
    environment, policy = load_expert(spec)
    first, count = FirstSuccesses(), episodes or testing.final_count or testing.episodes
    with used(environment):
        found = evaluate(environment, policy, episodes=count, seed=seed, heard=first)
    low, high = wilson(found.successes_end or 0, found.episodes)
    row = {"spec": spec.name, "policy": "expert", "seed": seed, "episodes": found.episodes}
    row |= {"success_any": found.success_any, "success_end": found.success_end, "low": low, "high": high}
    row |= {"steps": first.mean, "measures": found.counts.measures}
    if json:
        print_rows([row], json=True)
        return
    print_rows([{name: value for name, value in row.items() if name != "measures"}], json=False)
    print_rows(
        [{"measure": heading(name, one), "mean": one["mean"]} for name, one in found.measures.items()], json=False
    )
