"""`karolos play`, `karolos test` and `karolos export`: use a saved policy."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from karolos.errors import UsageError
from karolos.system import has_display

from .arguments import (
    APolicy,
    Changes,
    Checkpoint,
    Database,
    Json,
    PolicyOrSpec,
    Runs,
    chosen_checkpoint,
    open_run,
)
from .output import print_rows, print_table, say, warn

if TYPE_CHECKING:
    from karolos.core import Moment
    from karolos.records import RunFolder


def play(
    run: PolicyOrSpec,
    overrides: Changes = None,
    expert: Annotated[bool, typer.Option("--expert", help="Play the scripted expert of a spec's task.")] = False,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Film to write: FILE.mp4 or FILE.gif.")] = None,
    episodes: Annotated[
        int | None, typer.Option(min=1, help="Number of episodes. Default: 1 in a film, 5 in a window.")
    ] = None,
    failures: Annotated[
        bool, typer.Option("--failures", help="Show only failures: the first ones in 1,000 episodes.")
    ] = False,
    checkpoint: Checkpoint = None,
    width: Annotated[int, typer.Option(min=16, max=4096, help="Width of the film in pixels.")] = 640,
    height: Annotated[int, typer.Option(min=16, max=4096, help="Height of the film in pixels.")] = 480,
    runs: Runs = Path("runs"),
    database: Database = None,
) -> None:
    """Play test episodes of a run's policy, of a shipped policy, or with --expert of a spec's scripted expert.

    Writes a film: play.mp4 in the run's folder; NAME.mp4 in the current folder for a spec or a shipped policy. With
    environment.engine=bullet, a display and no --out it opens a window. If a run of yours and a shipped policy have
    the same NAME, NAME plays the run and shipped:NAME the shipped policy.
    """
    if width % 2 or height % 2:
        raise UsageError(f"a film of {width} x {height} pixels cannot be encoded", hint="use even numbers")
    changed = overrides or ()
    window = out is None and has_display()
    from rich.console import Console
    from rich.progress import track

    from karolos.evaluation.playing import load_expert, load_player, play_failures
    from karolos.evaluation.playing import play as play_all
    from karolos.evaluation.policies import has_window
    from karolos.records.shipped import is_shipped
    from karolos.report.video import check_video_path, write_film
    from karolos.specification import load_spec

    if expert:
        spec = load_spec(run, changed)
        target = out or Path(f"{spec.name}.mp4")
    else:
        folder = open_run(run, runs, database)
        target = out or (Path(f"{run}.mp4") if is_shipped(folder) else folder.path / "play.mp4")
    if not window:
        check_video_path(target)
    if expert:
        loading = load_expert(spec, window=window and has_window(spec))
    else:
        if modules := _modules(folder):
            say(f"{folder.id} names code of this machine: {', '.join(modules)} will be imported")
        name = chosen_checkpoint(folder, checkpoint)
        loading = load_player(folder, name, changed, window=window)
    with loading as player:
        spec, environment = player.spec, player.environment
        seed = spec.testing.seed
        if player.note:
            warn(player.note)
        if window and not has_window(spec):
            hint = " (environment.engine=bullet opens one)" if spec.robot else ""
            say(f"this environment has no window: a film is written{hint}")
            check_video_path(target)
            window = False
        count = episodes or (5 if window else 1)
        played = (play_failures if failures else play_all)(environment, player.policy, episodes=count, seed=seed)
        moments = _report_episodes(played)
        if window:
            for _ in moments:
                time.sleep(1 / environment.rate)
            return
        filmed = track(
            moments,
            "recording",
            total=count * (environment.signature.max_steps + 1),
            console=Console(stderr=True),
            transient=True,
            disable=not sys.stderr.isatty(),
        )
        beginning = write_film(target, filmed, environment, (width, height))
    if not (expert or out or failures or changed or is_shipped(folder)):
        from karolos.experiment.tensorboard_writer import add_film

        add_film(folder, name, beginning, (width // 2, height // 2))
    print(target)


def _modules(folder: RunFolder) -> list[str]:
    """The foreign modules that the run's spec makes karolos import: of plugins and of gymnasium ids."""
    from karolos.records.run_records import part_name
    from karolos.registry import entries
    from karolos.specification.tree import PARTS

    spec = folder.spec()
    named = [(entry, part_name(spec, key)) for key, kind in PARTS.items() for entry in entries(kind)]
    found = [entry.target for entry, name in named if entry.name == name and entry.distribution != "karolos"]
    environment = spec.get("environment")
    found += [str(environment.get("id", ""))] if isinstance(environment, dict) else []
    return sorted({module for module, colon, _ in (target.rpartition(":") for target in found) if colon})


def _report_episodes(moments: Iterator[Moment]) -> Iterator[Moment]:
    """Pass moments on, and print the outcome of each episode on stderr."""
    reached = False
    for moment in moments:
        reached = moment.success or (reached and moment.step > 0)
        yield moment
        if moment.over:
            failure = "no success" if moment.environment.signature.has_success else "over"
            outcome = "success" if moment.success else "reached, then lost" if reached else failure
            say(f"episode {moment.episode + 1}: {outcome} after {moment.step} steps, return {moment.total:,.2f}")
            measures = moment.environment.signature.measures
            values = zip(measures, moment.environment.measures().tolist(), strict=True)
            if known := [one.text(value) for one, value in values if math.isfinite(value)]:
                say(f"  {', '.join(known)}")


def zero_shot(
    run: PolicyOrSpec,
    overrides: Changes = None,
    episodes: Annotated[
        int | None, typer.Option(min=1, help="Number of episodes. Default: as in the final test.")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Root of the episodes' seeds. Default: as in the final test.")
    ] = None,
    checkpoint: Checkpoint = None,
    expert: Annotated[bool, typer.Option("--expert", help="Test the scripted expert of a spec's task.")] = False,
    randomize: Annotated[bool, typer.Option("--randomize", help="Randomize as in training.")] = False,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Test a run's saved policy under changed settings: another robot, other physics, randomization.

    Also prints the success of the same policy in the same episodes without the changes. By default the episodes are
    those of the run's final test, which are held out. The result is written to transfers.jsonl in the run's folder
    (shipped policies: shipped/NAME in the runs folder), and `karolos runs show` shows it. With --expert the scripted
    expert of a spec's task is tested.
    """
    if expert:
        if randomize or checkpoint:
            option = "--randomize" if randomize else "--checkpoint"
            raise UsageError(f"--expert takes no {option}", hint="it plays test episodes, and has no checkpoints")
        _score_expert(Path(run), overrides or (), episodes, seed, json=json)
        return
    folder = open_run(run, runs, database)
    from karolos.evaluation.zero_shot import keep, zero_shot_test
    from karolos.records.shipped import is_shipped
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
    if is_shipped(folder):
        keep(folder, done, runs)
    if json:
        print_rows([{"run": folder.id, **done.changed_row()}], json=True)
        return
    print_table(transfers_table([done], title=folder.id))
    if done.measures:
        print_table(measures_table(done.measures, "measures"))
    unused = "" if seed is not None else ", held out from training and choice"
    say(f"{done.episodes} episodes from seed {done.seed}{unused}")


def _score_expert(path: Path, overrides: Sequence[str], episodes: int | None, seed: int | None, *, json: bool) -> None:
    """Print the success of the expert of a spec's task in the episodes of its final test, or in the requested ones."""
    from karolos.evaluation.playing import FirstSuccesses, evaluate_alone
    from karolos.evaluation.policies import expert_policy
    from karolos.report.tables import heading
    from karolos.specification import load_spec

    spec = load_spec(path, overrides)
    testing = spec.testing
    seed = testing.final_seed if seed is None else seed
    first, count = FirstSuccesses(), episodes or testing.held_out_count
    found = evaluate_alone(spec, expert_policy, episodes=count, seed=seed, heard=first)
    low, high = found.interval(found.successes_end or 0)
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


def export(
    run: APolicy,
    changes: Changes = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FOLDER",
            help="Folder to write. Default: export in the run's folder; ./NAME for a shipped policy.",
        ),
    ] = None,
    checkpoint: Checkpoint = None,
    onnx: Annotated[
        bool | None,
        typer.Option("--onnx/--no-onnx", help="Also write policy.onnx. Default: yes if the package onnx is installed."),
    ] = None,
    card: Annotated[bool, typer.Option("--card", help="Also write README.md for the Hugging Face hub.")] = False,
    bundle: Annotated[
        bool, typer.Option("--bundle", help="Write everything that karolos-deploy needs on a robot's computer.")
    ] = False,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Write a run's policy for use without karolos: as an ONNX model, and as arrays for numpy.

    The inputs are observation and desired_goal; the files normalise them. The output is an action in [-1, 1], or the
    index of a discrete action. policy.json says what each number means. With --bundle, changes such as robot=ur5 make
    the bundle for another robot.
    """
    folder = open_run(run, runs, database)
    from karolos.records.shipped import is_shipped

    out = out or (Path(run) if is_shipped(folder) else folder.path / ("bundle" if bundle else "export"))
    chosen = chosen_checkpoint(folder, checkpoint)
    if bundle:
        from karolos.export.bundle import export_bundle

        done = export_bundle(folder, out, changes or (), checkpoint=chosen)
    else:
        if changes:
            raise UsageError(f"{changes[0]!r} changes nothing in a policy", where="override", hint="add --bundle")
        from karolos.export.export import export_policy

        done = export_policy(folder, out, checkpoint=chosen, onnx=onnx)
    row = {"run": folder.id, "checkpoint": done.checkpoint, "steps": done.steps, "folder": str(done.folder)}
    files = [path.name for path in done.files]
    if card:
        from karolos.export.card import write_card

        files.append(write_card(folder, done.checkpoint, done.folder).name)
    row |= {"files": files if json else " ".join(files), "error": done.error}
    print_rows([row], json=json)
    if onnx is None and "policy.onnx" not in files:
        warn("policy.onnx was not written, because the package onnx is missing; pip install 'karolos[onnx]' adds it")
