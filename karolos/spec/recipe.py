"""Frozen, picklable descriptions of parts and environments: what crosses to a worker process."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel


@dataclass(frozen=True)
class Part:
    """One part of a spec: which plugin, and its checked settings.

    Pickles by reference to the plugin's nested Settings class: unpickling imports that plugin's module and no other.
    """

    kind: str
    """A kind of `karolos.registry.KINDS`, e.g. "robots"."""
    name: str
    settings: Any
    """An instance of the plugin's `Settings`."""

    def dump(self) -> dict[str, Any]:
        """Name and every setting as they stand in a spec; JSON-able."""
        settings: BaseModel = self.settings
        return {"name": self.name, **settings.model_dump(mode="json")}

    def identity(self) -> dict[str, Any]:
        """Name and the settings that results depend on: all of them, or those that `Settings.identity()` gives."""
        identity = getattr(self.settings, "identity", None)
        return {"name": self.name, **identity()} if callable(identity) else self.dump()


@dataclass(frozen=True)
class Recipe:
    """How to build one environment."""

    environment: Part
    robot: Part | None = None
    task: Part | None = None
    randomization: tuple[tuple[str, Part], ...] = ()
    """What to draw at each reset ("task.gravity") and from which distribution, sorted by name."""
