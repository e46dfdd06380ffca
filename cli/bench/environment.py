"""karolos bench environment."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from .output import print_rows


class Control(StrEnum):
    """How an action moves an arm."""

    JOINT = "joint"
    CARTESIAN = "cartesian"


def environment(
    robot: Annotated[str, typer.Option(help="Name of a robot.")] = "panda",
    task: Annotated[str, typer.Option(help="Name of a task.")] = "reach",
    control: Annotated[Control | None, typer.Option(help="One control mode only; both by default.")] = None,
    seconds: Annotated[float, typer.Option(min=0.1, help="Time for the measurements together.")] = 10.0,
    peers: Annotated[bool, typer.Option("--peers", help="Beside panda-gym, where it is installed.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object per line.")] = False,
) -> None:
    """Steps per second of a robot with a task on one core, beside the bare physics of the same episodes."""
    if peers:
        from karolos.benchmarks.environment import measure_panda_gym

        print_rows(measure_panda_gym(seconds=seconds), as_json=as_json)
        return
    from karolos.benchmarks.environment import measure

    controls = [mode.value for mode in Control] if control is None else [control.value]
    print_rows(measure(robot, task, controls=controls, seconds=seconds), as_json=as_json)
