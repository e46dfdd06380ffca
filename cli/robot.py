"""`karolos robot`: an arm from a file, and how good policies are on it that never saw it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from karolos.errors import PluginError

from .arguments import Json
from .completion import complete_plugin
from .inspect import save_picture
from .output import print_line, print_rows, print_table, say

app = typer.Typer(
    name="robot", help="Check an arm from a URDF, and score it with the policies that ship.", no_args_is_help=True
)
Given = Annotated[str, typer.Argument(metavar="FILE|NAME", help="A URDF, or the name of an installed robot.")]
Gripper = Annotated[
    str,
    typer.Option(
        metavar="NAME", help="What it carries; own: its own hand.", autocompletion=complete_plugin("grippers")
    ),
]


@app.command()
def check(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A URDF.")],
    gripper: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="What it carries. Default: its own hand.", autocompletion=complete_plugin("grippers")
        ),
    ] = None,
    tool: Annotated[str | None, typer.Option(metavar="LINK", help="The link of the tool frame, z forwards.")] = None,
    flange: Annotated[
        str | None, typer.Option(metavar="LINK", help="The link that carries a gripper, z away from the arm.")
    ] = None,
    mass: Annotated[
        float | None, typer.Option(min=0.01, metavar="KG", help="Of the whole arm, as the data sheet says.")
    ] = None,
    repair: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a copy in which arithmetic repairs what it can.")
    ] = None,
    promises: Annotated[bool, typer.Option(help="Check what every robot promises.")] = True,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Picture to write: FILE.png.")] = None,
    json: Json = False,
) -> None:
    """Check an arm's file: all that is wrong with it, what is assumed and doubted, and what promises it breaks.

    Exit code 3 if the file cannot be used as it is, or if a promise is broken. With --repair a copy has masses from
    convex hulls, torques from gravity, meshes that are found elsewhere, and says each change.
    """
    from karolos.plugins.robot_check import check_file

    known = {"gripper": gripper, "tool": tool, "flange": flange}
    wrong = kept = 0
    for row in check_file(file, repaired=repair, mass=mass, promises=promises, **known):
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
    robot: Given,
    gripper: Gripper = "robotiq_2f85",
    policies: Annotated[
        str, typer.Option(metavar="ROBOT", help="Whose policies: of ur5, panda or iiwa; or one: ur5_pick.")
    ] = "ur5",
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of each policy.")] = 100,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder of the page and its films. Default: ./NAME-score.")
    ] = None,
    json: Json = False,
) -> None:
    """Play the policies that ship on a robot that they never saw: success, and why the other episodes fail.

    Nothing is trained. A page with a film of each task is written, and score.json with the same numbers.
    """
    from karolos.files import write_json, writing
    from karolos.plugins.robot_score import policies_of, score_robot, scores_table, write_score_page
    from karolos.records.shipped import shipped_names

    chosen = [policies] if policies in shipped_names() else policies_of(policies)
    overrides, notes, name = _overrides(robot, None if gripper == "own" else gripper)
    folder = out or Path(f"{name}-score")
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    scores = []
    for one in score_robot(chosen, overrides, episodes, folder):
        scores.append(one)
        say(f"{one.policy}: {one.refused or one.success}")
    write_score_page(folder / "score.html", name, notes, scores)
    rows = [asdict(one) for one in scores]
    write_json(folder / "score.json", {"robot": name, "overrides": overrides, "assumed": notes, "policies": rows})
    if json:
        print_rows(rows, json=True)
        return
    print_table(scores_table(scores))
    print_line(str(folder / "score.html"))


def _overrides(robot: str, gripper: str | None) -> tuple[list[str], list[str], str]:
    """The overrides that name a robot, what is assumed of its file, and what it is called."""
    from karolos.registry import names
    from karolos.robots.from_file import FromFile, proposal_of

    gripping = [f"robot.gripper={gripper or 'null'}"]
    if robot in names("robots"):
        return [f"robot.name={robot}", *gripping], [], robot
    path = Path(robot).absolute()
    settings = FromFile.Settings.model_validate({"file": str(path), "gripper": gripper})
    return ["robot.name=urdf", f"robot.file={path}", *gripping], list(proposal_of(settings).notes), path.stem
