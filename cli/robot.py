"""`karolos robot`: checks an arm's file, and scores the arm with policies that never saw it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from karolos.errors import KarolosError, NoSuchRunError, PluginError, UsageError

from .arguments import Database, Json, Runs, open_run
from .completion import complete_plugin
from .inspect import save_picture
from .output import print_line, print_rows, print_table, say

app = typer.Typer(
    name="robot", help="Check an arm's URDF, and score the arm with the shipped policies.", no_args_is_help=True
)
Gripper = Annotated[
    str,
    typer.Option(
        metavar="NAME", help="Gripper. own: the hand in the URDF.", autocompletion=complete_plugin("grippers")
    ),
]


@app.command()
def check(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A URDF (a path, or installed:PACKAGE/PATH).")],
    gripper: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Gripper. Default: the hand in the URDF.", autocompletion=complete_plugin("grippers")
        ),
    ] = None,
    tool: Annotated[str | None, typer.Option(metavar="LINK", help="Link of the tool frame, with z forwards.")] = None,
    flange: Annotated[
        str | None, typer.Option(metavar="LINK", help="Link that carries the gripper, with z away from the arm.")
    ] = None,
    mass: Annotated[
        float | None, typer.Option(min=0.01, max=100_000, metavar="KG", help="Mass of the whole arm by its data sheet.")
    ] = None,
    repair: Annotated[Path | None, typer.Option(metavar="FILE", help="Write a repaired copy of the file.")] = None,
    promises: Annotated[bool, typer.Option(help="Also check the contract of robots.")] = True,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Picture to write: FILE.png.")] = None,
    json: Json = False,
) -> None:
    """Check an arm's URDF: its errors, the assumptions and doubts of karolos, and the promises that the arm breaks.

    Exit code 3 if the file cannot be used as it is, or if a promise is broken. With --repair karolos writes a copy:
    masses from convex hulls, torques from gravity, meshes found elsewhere. The copy lists each change.
    """
    from karolos.plugins.robot_check import check_file
    from karolos.system.files import file_of

    known = {"gripper": gripper, "tool": tool, "flange": flange}
    wrong = kept = 0
    for row in check_file(file_of(file), repaired=repair, mass=mass, promises=promises, **known):
        image = row.pop("picture", None)
        if image is not None:
            if out is not None:
                save_picture(image, out)
                row["picture"] = str(out)
        elif json:
            print_rows([row], json=True)
        elif row["kind"] == "promise":
            kept += row["kept"]
            if not row["kept"]:
                print_line(f"BROKEN {row['promise'].rpartition('-')[2]}")
                print_line(f"       {row['what']} {row['problem']}")
        else:
            change = f"; repaired: {row['change']}" if row.get("change") else ""
            where = f"{row['where']}: " if "where" in row else ""
            print_line(f"{row['kind']}: {where}{row['what']}{change}")
        wrong += row["kind"] == "wrong" or row.get("kept") is False
    if kept and not json:
        print_line(f"kept: {kept} promises of a robot")
    if wrong:
        raise typer.Exit(PluginError.exit_code)


@app.command()
def score(
    robots: Annotated[
        list[str] | None,
        typer.Argument(metavar="FILE|NAME...", help="URDFs (paths, or installed:PACKAGE/PATH), or names of robots."),
    ] = None,
    gripper: Gripper = "robotiq_2f85",
    policies: Annotated[
        str, typer.Option(metavar="ROBOT", help="Policies of ur5, panda or iiwa, or one run (ur5_pick, @last).")
    ] = "ur5",
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of each policy.")] = 100,
    mass: Annotated[
        float | None,
        typer.Option(min=0.01, max=100_000, metavar="KG", help="Mass of the arm, used if its file needs repair."),
    ] = None,
    tool: Annotated[
        str | None, typer.Option(metavar="LINK", help="Link of the tool frame, in a file of two arms.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder for page and films. Default: ./NAME-score.")
    ] = None,
    listed: Annotated[bool, typer.Option("--list", help="Show the scores so far, of all robots or of these.")] = False,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Play the shipped policies on a robot that they never saw: success, and the causes of failures.

    Nothing is trained. Writes a page with a film of each task, and score.json with the same numbers. A URDF that
    cannot be used as it is gets repaired in a copy. Several robots get a folder each, and one table. Results are kept
    like those of `karolos test`.
    """
    from karolos.plans.robot_score import (
        arms_table,
        kept_scores,
        kept_table,
        policies_of,
        refused,
        score_robot,
        scores_table,
        write_score_page,
    )
    from karolos.registry import names
    from karolos.system.files import write_json, writing

    robots = robots or []
    if listed:
        wanted = {Path(one).stem for one in robots}
        rows = [row for row in kept_scores(runs) if row["robot"] in wanted or not wanted]
        if not rows:
            say(f"there are no scores in {runs}, or none of these robots")
        print_rows(rows, json=True) if json else print_table(kept_table(rows))
        return
    if not robots:
        raise UsageError("no robot is given", hint="name a URDF or a robot; --list shows the scores so far")
    try:
        chosen = [] if policies in names("robots") else [open_run(policies, runs, database).path]
    except NoSuchRunError:
        chosen = []
    chosen = chosen or policies_of(policies)
    every = []
    for robot in robots:
        name = Path(robot).stem
        folder = (out or Path()) / f"{name}-score" if len(robots) > 1 or out is None else out
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
        overrides: list[str] = []
        notes: list[str] = []
        try:
            overrides, notes, name = _overrides(robot, None if gripper == "own" else gripper, mass, tool)
            found = score_robot(chosen, overrides, episodes, folder, runs)
        except KarolosError as error:
            if len(robots) == 1:
                raise
            found = iter([refused(one, episodes, error) for one in chosen])
        scores = []
        for one in found:
            scores.append(one)
            say(f"{name}: {one.policy}: {one.refused or one.success}")
        write_score_page(folder / "score.html", name, notes, scores)
        rows = [asdict(one) for one in scores]
        write_json(folder / "score.json", {"robot": name, "overrides": overrides, "assumed": notes, "policies": rows})
        every.append((name, scores))
        if json:
            print_rows([{"robot": name, **row} for row in rows] if len(robots) > 1 else rows, json=True)
        else:
            print_table(scores_table(scores))
            print_line(str(folder / "score.html"))
    if len(robots) > 1 and not json:
        print_table(arms_table(every))


def _overrides(
    robot: str, gripper: str | None, mass: float | None, tool: str | None
) -> tuple[list[str], list[str], str]:
    """The overrides that name a robot, the assumptions about its file, and its name."""
    from karolos.plans.robot_score import file_overrides
    from karolos.registry import names

    gripping = [f"robot.gripper={gripper or 'null'}"]
    if robot in names("robots"):
        return [f"robot.name={robot}", *gripping], [], robot
    given, notes, name = file_overrides(robot, gripper, mass, tool)
    return [*given, *gripping], notes, name
