"""Which physics engines are installed, and worlds of a named one."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any, Literal, get_args

from ..errors import UsageError
from .interface import World

Engine = Literal["mujoco", "bullet"]
ENGINE_MODULES: dict[Engine, str] = {"mujoco": "mujoco", "bullet": "pybullet"}
"""The module that each engine needs."""
ENGINE_PACKAGES: dict[Engine, str] = {"mujoco": "mujoco-core", "bullet": "pybullet"}
"""The package that it comes in."""
WINDOWS: tuple[Engine, ...] = ("bullet",)
"""Engines that show their world in a window. Each makes pictures."""


def installed(engine: Engine) -> bool:
    return find_spec(ENGINE_MODULES[engine]) is not None


def installed_one(wanted: Engine) -> Engine:
    """The wanted engine; another one where it is not installed."""
    return next(filter(installed, (wanted, *get_args(Engine))), wanted)


def check_engine(engine: Engine) -> None:
    """Raise UsageError when the engine is not installed."""
    if not installed(engine):
        raise UsageError(
            f"the engine {engine} is not installed",
            setting="environment.engine",
            hint=f"pip install {ENGINE_PACKAGES[engine]}, or choose another engine",
        )


def make_world(engine: Engine, **settings: Any) -> World:
    """A new world. `settings`: those of its class, e.g. `MujocoWorld`."""
    check_engine(engine)
    world: World = getattr(import_module(f".{engine}.world", __package__), f"{engine.title()}World")(**settings)
    return world
