"""The orchestrator that finds its own layout."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from typing import Any

from pydantic import Field as Setting

from ..core import FloatArray, Orchestrator, Received
from ..environments.build import build_environment
from .commands import Build
from .local import Limits, Local, Named
from .probe import Measured, choose, probe

_probed: dict[bytes, list[Measured]] = {}
"""What was measured for a robot and task in this process: a run's tests need no second probe."""


class Auto(Orchestrator):
    """The local orchestrator in the layout that was fastest in a probe of a few seconds on this machine.

    Results do not depend on the layout, so that the probe's timing changes no run: a spec with `auto` and one with
    `local` and as many environments are the same experiment. What was measured and chosen stands in `describe`.
    """

    class Settings(Limits):
        environments: int = Setting(default=8, ge=1, le=65536, description="environments in all")
        seconds: float = Setting(
            default=3.0, gt=0, description="seconds of stepping that the probe takes; starting its workers comes on top"
        )

        @property
        def size(self) -> int:
            """Environments in all."""
            return self.environments

        def identity(self) -> dict[str, Any]:
            """What results depend on: how many episodes run side by side."""
            return {"name": "local", "environments": self.environments}

    def __init__(self, settings: Auto.Settings, recipe: Any, *, build: Build = build_environment) -> None:
        """Measure, choose, and start the workers.

        Raises:
            KarolosError: as `Local` does.
        """
        key = pickle.dumps((build, getattr(recipe, "robot", recipe), getattr(recipe, "task", None), settings))
        if key not in _probed:
            _probed[key] = probe(recipe, settings.environments, settings.seconds, build)
        self.measured = _probed[key]
        self.chosen = choose(self.measured)
        self._local = Local(
            Local.Settings(
                processes=self.chosen.processes,
                threads=self.chosen.threads,
                time_limit=settings.time_limit,
                failures=settings.failures,
            ),
            recipe,
            size=settings.environments,
            build=build,
        )
        self.signature, self.size = self._local.signature, self._local.size

    def reset(self, environments: Named, seeds: Sequence[int]) -> None:
        self._local.reset(environments, seeds)

    def step(self, environments: Named, actions: FloatArray, *, updates: int = 0) -> None:
        self._local.step(environments, actions, updates=updates)

    def receive(self, at_least: int | None = None) -> Received:
        return self._local.receive(at_least)

    def parameters(self, environments: Named) -> FloatArray:
        return self._local.parameters(environments)

    def describe(self) -> dict[str, Any]:
        """The layout chosen, and every layout measured with its steps per second."""
        return {**self._local.describe(), "measured": [found.dump() for found in self.measured]}

    def close(self) -> None:
        self._local.close()
