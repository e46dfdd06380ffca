"""`karolos play`: a trained agent or a scripted expert in a window or as a film."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from karolos.errors import UsageError
from karolos.system import has_display

from .arguments import Changes, Checkpoint, Database, PolicyOrSpec, Runs, chosen_checkpoint, open_run
from .output import say, warn

if TYPE_CHECKING:
    from karolos.evaluation.playing import Moment
    from karolos.records import RunFolder


def play(
    run: PolicyOrSpec,
    overrides: Changes = None,
    expert: Annotated[bool, typer.Option("--expert", help="Play the expert of a spec's task instead.")] = False,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Film to write: FILE.mp4 or FILE.gif.")] = None,
    episodes: Annotated[
        int | None, typer.Option(min=1, help="Episodes to play. Default: 1 for a film, 5 in a window.")
    ] = None,
    failures: Annotated[
        bool, typer.Option("--failures", help="Only episodes that fail: the first ones of 1,000.")
    ] = False,
    checkpoint: Checkpoint = None,
    width: Annotated[int, typer.Option(min=16, max=4096, help="Width of the film in pixels.")] = 640,
    height: Annotated[int, typer.Option(min=16, max=4096, help="Height of the film in pixels.")] = 480,
    runs: Runs = Path("runs"),
    database: Database = None,
) -> None:
    """Play test episodes of a run's saved policy, of one that ships, or with --expert of the scripted one for a spec.

    Opens a window if there is a display and the physics engine has one: environment.engine=bullet. Otherwise, or with
    --out, writes a film. Default: play.mp4 in the run's folder, or NAME.mp4 in the current folder for a spec or a
    policy that ships. A run of your own with the name of a policy that ships is played instead of it; shipped:NAME
    plays that one.
    """
    if width % 2 or height % 2:
        raise UsageError(f"a film of {width} x {height} pixels cannot be encoded", hint="use even numbers")
    changed = overrides or ()
    window = out is None and has_display()
    from rich.console import Console
    from rich.progress import track

    from karolos.environments.build import used
    from karolos.evaluation.changed_spec import load_player
    from karolos.evaluation.playing import play as play_all
    from karolos.evaluation.playing import play_failures
    from karolos.evaluation.policies import engine_of, has_window, load_expert
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
    note = None
    if expert:
        environment, policy = load_expert(spec, window=window and has_window(spec))
    else:
        if modules := _modules(folder):
            say(f"{folder.id} names code of this machine: {', '.join(modules)} will be imported")
        name = chosen_checkpoint(folder, checkpoint)
        player = load_player(folder, name, changed, window=window)
        spec, environment, policy, note = player.spec, player.environment, player.policy, player.note
    if note:
        warn(note)
    with used(environment):
        if window and not has_window(spec):
            hint = " (environment.engine=bullet opens one)" if engine_of(spec) else ""
            say(f"this environment has no window: a film is written{hint}")
            check_video_path(target)
            window = False
        count = episodes or (5 if window else 1)
        played = (play_failures if failures else play_all)(environment, policy, episodes=count, seed=spec.testing.seed)
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
        _show_in_tensorboard(folder, name, beginning, (width // 2, height // 2))
    print(target)


def _modules(folder: RunFolder) -> list[str]:
    """The modules that the run's spec makes karolos import: of plugins that are not karolos's, and of gymnasium ids."""
    from karolos.records.run_records import part_name
    from karolos.registry import entries
    from karolos.specification.tree import PARTS

    spec = folder.spec()
    named = [(entry, part_name(spec, key)) for key, kind in PARTS.items() for entry in entries(kind)]
    found = [entry.target for entry, name in named if entry.name == name and entry.distribution != "karolos"]
    environment = spec.get("environment")
    found += [str(environment.get("id", ""))] if isinstance(environment, dict) else []
    return sorted({module for module, colon, _ in (target.rpartition(":") for target in found) if colon})


def _show_in_tensorboard(folder: RunFolder, checkpoint: str, film: bytes, size: tuple[int, int]) -> None:
    from karolos.experiment.tensorboard_writer import add_film
    from karolos.records.checkpoint import read_meta

    add_film(folder.tensorboard, film, size, read_meta(folder.checkpoints, checkpoint)["steps"])


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
