"""`karolos bench updates`."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from karolos.errors import UsageError

from ..arguments import Json
from .output import print_measurements


class Device(StrEnum):
    """Where an agent learns."""

    AUTO = "auto"
    CPU = "cpu"
    CUDA = "cuda"


def updates(
    threads: Annotated[str, typer.Option(help="Numbers of CPU threads to measure with: 1,2.")] = "1",
    only: Annotated[
        str | None, typer.Option(help="Names of agents: sac,td3. Default: all with a replay buffer.")
    ] = None,
    device: Annotated[Device, typer.Option(help="Where the agents learn.")] = Device.CPU,
    seconds: Annotated[float, typer.Option(min=0.1, help="Time per number of threads.")] = 20.0,
    peers: Annotated[bool, typer.Option("--peers", help="Measure stable-baselines3 and SBX too.")] = False,
    json: Json = False,
) -> None:
    """Measure gradient updates per second: two hidden layers of 256, batches of 256, 20 inputs, 4 actions."""
    from karolos.agents.device import resolve_device
    from karolos.benchmarks.updates import AGENTS, measure

    agents = AGENTS if only is None else tuple(only.split(","))
    unknown = [agent for agent in agents if agent not in AGENTS]
    if unknown:
        raise UsageError(
            f"no benchmark of updates for {unknown[0]!r}", where="--only", hint=f"one of {', '.join(AGENTS)}"
        )
    rows = measure(
        agents=agents,
        threads=_numbers(threads),
        device=resolve_device(device.value),
        peers=peers,
        seconds=seconds,
    )
    print_measurements(rows, json=json)


def _numbers(text: str) -> list[int]:
    """The numbers in a text such as "1,2"."""
    parts = text.split(",")
    if not all(part.strip().isdecimal() and int(part) > 0 for part in parts):
        raise UsageError(f"{text!r} is not a list of numbers of threads", where="--threads", hint="write 1,2")
    return [int(part) for part in parts]
