"""Which physics engines are installed, and worlds of a named one."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any, Literal, get_args

from ..errors import UsageError
from .interface import World

Engine = Literal["bullet", "mujoco"]
ENGINE_MODULES: dict[Engine, str] = {"bullet": "pybullet", "mujoco": "mujoco"}
"""The library that each engine needs. The first that is installed is the default."""


def installed(engine: Engine) -> bool:
    return find_spec(ENGINE_MODULES[engine]) is not None


def default_engine() -> Engine:
    """PyBullet where it is installed, else MuJoCo."""
    return next(filter(installed, get_args(Engine)), "bullet")


def check_engine(engine: Engine) -> None:
    """Raise UsageError when the engine is not installed."""
    if not installed(engine):
        raise UsageError(
            f"the engine {engine} is not installed",
            setting="environment.engine",
            hint=f"pip install 'karolos[{engine}]', or choose another engine",
        )


def make_world(engine: Engine, **settings: Any) -> World:
    """A new world. `settings`: those of the engine's class `World`."""
    check_engine(engine)
    world: World = import_module(f".{engine}.world", __package__).World(**settings)
    return world
