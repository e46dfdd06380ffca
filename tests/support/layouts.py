"""Layouts of processes, threads and environments for tests of the orchestrator."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from karolos.core import Environment
from karolos.orchestrator.local import Local
from support.fake_environments import Fake

IN_PROCESS, ONE, TWO, THREADS = (0, 1, 4), (1, 1, 4), (2, 1, 2), (1, 2, 2)
every_layout = pytest.mark.parametrize("layout", [IN_PROCESS, ONE, TWO, THREADS], ids=["0", "1", "2", "threads"])


def make(
    layout: tuple[int, int, int],
    recipe: Any = "",
    build: Callable[[Any], Environment] = Fake,
    failures: int = 0,
    **settings: float,
) -> Local:
    processes, threads, environments = layout
    chosen = Local.Settings(
        processes=processes, threads=threads, environments=environments, failures=failures, **settings
    )
    return Local(chosen, partial(build, recipe))


def reset(orchestrator: Local) -> list[int]:
    """Reset all; the process of each environment."""
    orchestrator.reset(range(orchestrator.size), range(orchestrator.size))
    return [int(pid) for pid in orchestrator.receive().step.observation[:, 0]]


def step(orchestrator: Local, *troubles: float) -> None:
    orchestrator.step(range(len(troubles)), np.array(troubles, np.float32)[:, None])
