"""Frozen, picklable descriptions of parts and environments, also for worker processes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel


@dataclass(frozen=True)
class Part:
    """One part of a spec: a plugin and its validated settings.

    Unpickling imports the plugin's module, for its Settings class, and no other plugin.
    """

    kind: str
    """A kind of `karolos.registry.KINDS`, e.g. "robots"."""
    name: str
    settings: Any
    """An instance of the plugin's `Settings`."""

    def dump(self) -> dict[str, Any]:
        """Name and all settings as in a spec; JSON-able."""
        settings: BaseModel = self.settings
        return {"name": self.name, **settings.model_dump(mode="json")}

    def identity(self) -> dict[str, Any]:
        """Name and the settings that results depend on: `Settings.identity()` if defined, otherwise all."""
        identity = getattr(self.settings, "identity", None)
        return {"name": self.name, **identity()} if callable(identity) else self.dump()


@dataclass(frozen=True)
class Recipe:
    """How to build one environment."""

    environment: Part
    robot: Part | None = None
    task: Part | None = None
    randomization: tuple[tuple[str, Part], ...] = ()
    """Parameters to draw at each reset ("task.gravity") with their distributions, sorted by name."""
