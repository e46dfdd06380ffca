"""PyBullet's functions for one world."""

from __future__ import annotations

import os
import sys
from functools import partial
from threading import Lock
from typing import Any

from ...errors import MachineError
from ...system import has_display

_IMPORTING = Lock()


def _pybullet() -> Any:
    """The module, imported when a world is built, so that specs are checked without it.

    PyBullet prints its build time on stderr at import, which would interrupt progress bars: stderr is closed meanwhile.
    """
    with _IMPORTING:
        if "pybullet" in sys.modules:
            return sys.modules["pybullet"]
        stderr = os.dup(2)
        with open(os.devnull, "wb") as devnull:
            os.dup2(devnull.fileno(), 2)
        try:
            import pybullet  # noqa: PLC0415
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
        return pybullet


class Client:
    """A connection to PyBullet: its attributes are PyBullet's, and functions act in the world of this connection.

    Raises MachineError when a window is requested and there is no display.
    """

    def __init__(self, *, window: bool) -> None:
        if window and not has_display():  # pybullet would end the process
            raise MachineError("no display to show a window on", hint="set DISPLAY, or run without a window")
        self._module = pybullet = _pybullet()
        self._number = pybullet.connect(pybullet.GUI if window else pybullet.DIRECT)
        if self._number < 0:
            raise MachineError("the physics engine does not start", hint="too many worlds, or no display for a window")

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # also where a copy asks before there is a module
            raise AttributeError(name)
        found = getattr(self._module, name)
        if callable(found) and not isinstance(found, type):
            found = partial(found, physicsClientId=self._number)
        setattr(self, name, found)  # looked up once
        return found

    def close(self) -> None:
        """Free the world. A second call has no effect."""
        if self._number >= 0:
            self.disconnect()
            self._number = -1
