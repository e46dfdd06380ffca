"""The physics engines: their needs and abilities, and worlds of a named one."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Literal, NamedTuple

from ..errors import UsageError
from ..system import has_display
from .interface import Ability, World

Engine = Literal["mujoco", "bullet"]
CALLED: dict[Ability, str] = {
    "impedance": "impedance control",
    "suction": "suction",
    "materials": "stiffness, damping or restitution of single bodies",
    "window": "window",
}


class PhysicsEngine(NamedTuple):
    """The facts of an engine, known without a world."""

    name: Engine
    module: str
    """Package that it needs."""
    package: str
    """Extra of karolos that installs it."""
    abilities: frozenset[Ability]

    @property
    def installed(self) -> bool:
        return find_spec(self.module) is not None

    @property
    def has_window(self) -> bool:
        """Whether it can show a world in a window on this machine."""
        return "window" in self.abilities and has_display()

    def or_another(self) -> PhysicsEngine:
        """This engine; another one if it is not installed."""
        return next((engine for engine in (self, *ENGINES.values()) if engine.installed), self)

    def check(self, needs: Mapping[str, Ability]) -> None:
        """Raise UsageError when the engine is not installed, or lacks an ability that a setting needs."""
        if not self.installed:
            raise UsageError(
                f"the engine {self.name} is not installed",
                setting="environment.engine",
                hint=f"pip install {self.package}, or choose another engine",
            )
        for setting, ability in needs.items():
            if ability not in self.abilities:
                raise self.lacks(ability, setting)

    def lacks(self, ability: Ability, setting: str = "environment.engine") -> UsageError:
        """The error of an engine without this ability."""
        able = next(engine.name for engine in ENGINES.values() if ability in engine.abilities)
        what = f"the engine {self.name} has no {CALLED[ability]}"
        return UsageError(what, setting=setting, hint=f"set environment.engine={able}")


MUJOCO = PhysicsEngine("mujoco", "mujoco", "mujoco-core", frozenset({"impedance", "suction", "materials"}))
BULLET = PhysicsEngine("bullet", "pybullet", "pybullet", frozenset({"window"}))
ENGINES: dict[Engine, PhysicsEngine] = {"mujoco": MUJOCO, "bullet": BULLET}


def make_world(engine: Engine, **settings: Any) -> World:
    """A new world. `settings`: those of its class, e.g. `MujocoWorld`."""
    ENGINES[engine].check({})
    module = import_module(f".{engine}.world", __package__)
    world: World = getattr(module, f"{engine.title()}World")(**settings)
    return world
