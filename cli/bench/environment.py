"""`karolos bench environment`."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from ..arguments import Json
from .output import print_measurements


class Control(StrEnum):
    """How an action moves an arm."""

    JOINT = "joint"
    CARTESIAN = "cartesian"


def environment(
    robot: Annotated[str, typer.Option(help="Name of a robot.")] = "panda",
    task: Annotated[str, typer.Option(help="Name of a task.")] = "reach",
    control: Annotated[Control | None, typer.Option(help="Only this control mode. Default: both.")] = None,
    seconds: Annotated[float, typer.Option(min=0.1, help="Time for all measurements together.")] = 10.0,
    peers: Annotated[bool, typer.Option("--peers", help="Measure panda-gym too, if it is installed.")] = False,
    json: Json = False,
) -> None:
    """Measure steps per second of a robot with a task on one core, beside the bare physics of the same episodes."""
    if peers:
        from karolos.benchmarks.environment import measure_panda_gym

        print_measurements(measure_panda_gym(seconds=seconds), json=json)
        return
    from karolos.benchmarks.environment import measure

    controls = [mode.value for mode in Control] if control is None else [control.value]
    print_measurements(measure(robot, task, controls=controls, seconds=seconds), json=json)
