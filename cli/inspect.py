"""`karolos inspect`: a robot, a gripper or a task as a picture and as numbers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from karolos.errors import MachineError, UsageError

from .arguments import Json
from .completion import complete_plugin
from .output import print_line, print_rows

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

app = typer.Typer(
    name="inspect", help="Show a robot, a gripper or a task: a picture and its numbers.", no_args_is_help=True
)
Out = Annotated[
    Path | None, typer.Option("--out", metavar="FILE", help="Picture to write: FILE.png. Default: ./NAME.png.")
]
Size = Annotated[int, typer.Option(min=16, max=2048, help="Size of the picture in pixels.")]


@app.command()
def robot(
    name: Annotated[str, typer.Argument(metavar="NAME", autocompletion=complete_plugin("robots"))],
    out: Out = None,
    width: Size = 960,
    height: Size = 720,
    json: Json = False,
) -> None:
    """Show a robot: joints with limits, workspace, control modes, layouts, parameters for randomization."""
    _show("robot", name, out, json=json, size=(width, height))


@app.command()
def gripper(
    name: Annotated[str, typer.Argument(metavar="NAME", autocompletion=complete_plugin("grippers"))],
    out: Out = None,
    width: Size = 960,
    height: Size = 720,
    json: Json = False,
) -> None:
    """Show a gripper: its numbers, and the workspace of each arm that carries it."""
    _show("gripper", name, out, json=json, size=(width, height))


@app.command()
def task(
    name: Annotated[str, typer.Argument(metavar="NAME", autocompletion=complete_plugin("tasks"))],
    robot: Annotated[
        str,
        typer.Option(metavar="NAME", help="Robot that shows the task.", autocompletion=complete_plugin("robots")),
    ] = "panda",
    out: Out = None,
    width: Size = 960,
    height: Size = 720,
    json: Json = False,
) -> None:
    """Show a task: goal rule, layouts, settings, parameters for randomization."""
    _show("task", name, out, json=json, size=(width, height), robot=robot)


def save_picture(picture: NDArray[np.uint8], target: Path) -> None:
    """Write a picture. Raises MachineError."""
    from PIL import Image

    try:
        Image.fromarray(picture).save(target)
    except OSError as error:
        raise MachineError(f"cannot write {target}: {error.strerror or error}") from error


def _show(kind: str, name: str, out: Path | None, *, json: bool, **how: Any) -> None:
    """Write the picture, and print the facts. `how`: of `karolos.plugins.inspection.inspect_robot` and the others."""
    target = out or Path(f"{name}.png")
    if target.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        hint = "name a file that ends in .png or .jpg"
        raise UsageError(f"{target.name} does not end like a picture's name", hint=hint)
    if not target.parent.is_dir():
        raise UsageError(f"there is no folder {target.parent} to write a picture into")
    from karolos.plugins import inspection

    functions: dict[str, Callable[..., inspection.Inspection]] = {
        "robot": inspection.inspect_robot,
        "gripper": inspection.inspect_gripper,
        "task": inspection.inspect_task,
    }
    found = functions[kind](name, **how)
    if found.picture is not None:
        save_picture(found.picture, target)
    if json:
        row = {"kind": kind, "name": found.name, "about": found.about, **found.tables, "picture": str(target)}
        print_rows([row], json=True)
        return
    for line in (f"{kind} {found.name}", "", *found.about.splitlines(), *([""] if found.about else [])):
        print_line(line)
    for heading, lines in found.tables.items():
        print(f"{heading}:" if lines else f"{heading}: none")
        print_rows(lines, json=False)
        print()
    print(f"picture: {target}")
