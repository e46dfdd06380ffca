"""`karolos dataset`: record episodes of a policy or an expert as a dataset."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from karolos.errors import UsageError
from karolos.report.tables import counted

from .arguments import Changes, Checkpoint, Database, Json, PolicyOrSpec, Runs, chosen_checkpoint, open_run
from .output import print_rows, say, warn

if TYPE_CHECKING:
    from karolos.recordings.playing import Recorder
    from karolos.recordings.recording import Played, RecordingFolder
    from karolos.specification import Spec
    from karolos.specification.parts import Recipe

UNFINISHED = ".recording"
"""Folder in --out that holds the episodes until the dataset is written, so that the same command can continue."""


def dataset(
    run: PolicyOrSpec,
    overrides: Changes = None,
    out: Annotated[Path, typer.Option("--out", metavar="FOLDER", help="Folder to write.")] = Path("dataset"),
    episodes: Annotated[int, typer.Option(min=1, help="Episodes in the dataset.")] = 100,
    expert: Annotated[bool, typer.Option("--expert", help="Record the scripted expert of a spec's task.")] = False,
    format: Annotated[
        Literal["lerobot", "minari", "karolos"],
        typer.Option(help="lerobot: LeRobotDataset v3. minari: Minari dataset. karolos: one .npz per episode."),
    ] = "lerobot",
    only: Annotated[Literal["success"] | None, typer.Option(help="Keep only episodes that end with success.")] = None,
    noise: Annotated[
        float, typer.Option(min=0, max=10, help="Standard deviation of Gaussian noise on the actions.")
    ] = 0.0,
    random: Annotated[float, typer.Option(min=0, max=1, help="Probability that an action is random.")] = 0.0,
    randomize: Annotated[bool, typer.Option("--randomize", help="Randomize each episode as in training.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Root of the episodes' seeds.")] = 0,
    camera: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Film each episode with this camera: front or wrist. Only for lerobot."),
    ] = None,
    size: Annotated[int, typer.Option(min=16, max=2048, help="Width and height of a picture in pixels.")] = 224,
    checkpoint: Checkpoint = None,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Record episodes of a run's policy, of a shipped policy, or with --expert of a spec's scripted expert.

    Episodes are played in the processes and environments of the spec's orchestrator. The same command continues an
    interrupted recording. An episode's seeds and noise depend only on its number.
    """
    from karolos.core.seeding import SeedTree
    from karolos.evaluation.changed_spec import changed_spec, engine_note
    from karolos.evaluation.policies import load_agent
    from karolos.recordings.card import card
    from karolos.recordings.recording import RecordingFolder
    from karolos.system.files import write_whole

    chosen = {"episodes": episodes, "only": only, "noise": noise, "random": random}
    chosen |= {"randomize": randomize, "seed": seed}
    if expert:
        from karolos.specification import load_spec

        spec, act, policy = load_spec(run, overrides or ()), None, "the task's scripted expert"
        recipe = spec.recipe(randomize=randomize)
    else:
        folder = open_run(run, runs, database)
        name = chosen_checkpoint(folder, checkpoint)
        saved = load_agent(folder, name)
        spec = changed_spec(saved.spec, overrides or (), trained=saved.signature, randomize=randomize)
        act, policy = saved.policy().act, f"{folder.id}, checkpoint {name}"
        recipe = spec.recipe(randomize=True)  # its distributions stay in the spec
        if note := engine_note(saved.spec, spec):
            warn(note)
    if camera and (format != "lerobot" or size % 2):
        raise UsageError("--camera needs --format lerobot and an even --size")
    if format != "karolos":
        from karolos.recordings.recording import require

        require({"lerobot": "pyarrow"}.get(format, format), format, f"--format {format}")
    from karolos.recordings.playing import Recorder, expert_act

    recording = RecordingFolder(out if format == "karolos" else out / UNFINISHED)
    about = _about(spec, recipe, policy, chosen)
    films = recording.path / "films" if camera else None
    if camera:
        from karolos.recordings.cameras import poses

        about["cameras"] = poses(recipe, tuple(dict.fromkeys(camera)), (size, size))
    _check_same(recording, about, out)
    recording.begin(about)
    with _orchestrator(spec, recipe, films, about, expert=expert) as environments:
        recorder = Recorder(
            environments,
            act or expert_act(environments.signature),
            SeedTree(seed).child("dataset"),
            recording,
            episodes,
            only_success=only is not None,
            noise=noise,
            random=random,
            hidden=environments.signature.action.size if expert else 0,
        )
        played = _run(recorder, episodes)
    done = {**about, "outcome": _outcome(played)}
    _write(format, out, done, recording, films)
    write_whole(out / "README.md", card(done))
    if format == "karolos":
        recording.begin(done)
    else:
        from karolos.system import remove_tree

        remove_tree(recording.path, ignore_errors=True)
    counts = {name: value for name, value in done["outcome"].items() if isinstance(value, int)}
    print_rows([{"folder": str(out), "format": format, **counts}], json=json)


def _about(spec: Spec, recipe: Recipe, policy: str, chosen: dict[str, Any]) -> dict[str, Any]:
    """Meaning and origin of the numbers. Only the number of episodes may change when the recording continues."""
    from karolos.errors import recorded
    from karolos.recordings.recording import describe
    from karolos.records import provenance

    versions, code = provenance.versions(), provenance.code(Path.cwd())
    dumped = spec.dump()
    return describe(
        recipe,
        {
            "title": f"{spec.name}: {policy}",
            "task": spec.name,
            "robot": spec.robot.name if spec.robot else spec.environment.name,
            "policy": policy,
            **chosen,
            "spec": recorded(
                {key: dumped[key] for key in ("robot", "task", "environment", "randomization") if key in dumped}
            ),
            "experiment": spec.hash(),
            "versions": {
                name: versions[name] for name in ("karolos", "python", "numpy", "mujoco-core") if name in versions
            },
            "commit": code[0]["commit"] + (" and uncommitted changes" if code[0]["dirty"] else "") if code else None,
        },
    )


def _outcome(played: Sequence[Played]) -> dict[str, Any]:
    """Number of episodes that were played, kept and successful."""
    from math import isfinite
    from statistics import fmean

    from karolos.records.intervals import wilson

    successes = sum(one.success for one in played)
    low, high = wilson(successes, len(played))
    means = {}
    for name in sorted({name for one in played for name in one.measures}):
        means[name] = fmean(one.measures[name] for one in played if name in one.measures)
    return {
        "played": len(played),
        "successes": successes,
        "success_interval": [low, high],
        "kept": sum(one.kept for one in played),
        "failed_and_left_out": sum(not (one.kept or one.diverged) for one in played),
        "diverged_and_left_out": sum(one.diverged for one in played),
        "measures": {name: mean for name, mean in means.items() if isfinite(mean)},
    }


def _check_same(recording: RecordingFolder, about: dict[str, Any], out: Path) -> None:
    """Raise UsageError unless the folder is empty, missing, or holds the beginning of the same dataset."""
    from json import dumps, loads

    from karolos.system.files import writing

    if out.suffix in (".npz", ".parquet", ".hdf5", ".zip"):
        hint = "--format karolos writes one .npz per episode into it" if out.suffix == ".npz" else None
        raise UsageError("names a file, and a dataset is a folder", where=f"--out {out}", hint=hint)
    with writing(out):  # a file may be in the way
        if not out.exists() or not any(out.iterdir()):
            return
    before = recording.about()
    if before is None:
        raise UsageError("the folder is not empty", where=str(out), hint="name another folder with --out")
    before.pop("outcome", None)
    now = loads(dumps(about))
    changed = sorted(key for key in {*before, *now} - {"episodes"} if before.get(key) != now.get(key))
    if changed:
        what = f"it holds the beginning of another dataset: {', '.join(changed)} differ"
        raise UsageError(what, where=str(out), hint="name another folder with --out")
    say(f"{out} goes on after {counted(len(recording.played()), 'episode')}")


def _orchestrator(spec: Spec, recipe: Recipe, films: Path | None, about: dict[str, Any], *, expert: bool) -> Any:
    """The spec's environments, filmed or not; with the expert's actions at the end of observations."""
    from karolos.recordings.playing import build_recorded

    cameras = about.get("cameras", {})
    build: Any = partial(build_recorded, recipe, expert=expert)
    if films:
        from karolos.recordings.cameras import build_filmed
        from karolos.recordings.lerobot import whole_rate

        films.mkdir(parents=True, exist_ok=True)
        seen: dict[str, Any] = {"cameras": tuple(cameras), "rate": whole_rate(about["rate"])}
        [size, *_] = {(one["width"], one["height"]) for one in cameras.values()}
        build = partial(build_filmed, recipe, expert=expert, folder=films.resolve(), size=size, **seen)
    return spec.orchestrator.make(build)


def _run(recorder: Recorder, episodes: int) -> Any:
    import sys

    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task("recording", total=episodes)
        recorder.on_episode = lambda kept: bar.update(task, completed=kept)
        return recorder.run()


def _write(format: str, out: Path, about: dict[str, Any], recording: RecordingFolder, films: Path | None) -> None:
    if format == "lerobot":
        from karolos.recordings.lerobot import write_lerobot

        write_lerobot(out, about, recording.recordings(), about["task"], films)
    elif format == "minari":
        from karolos.recordings.minari_file import write_minari

        kind = "expert" if "expert" in about["policy"] else "policy"
        write_minari(out, about, recording.recordings(), f"karolos/{about['title'].partition(':')[0]}/{kind}-v0")
