"""Gripper and cameras of drivers of real arms. They answer more slowly than the arm."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..bundle import Bundle
from ..faults import Fault
from ..kinematics import Array
from . import Driver
from .simulation import Channel

RATE = 125.0
"""Number of requests per second."""


class SensedDriver(Driver):
    """A driver of a real arm, which has `Sensors` as soon as it is connected."""

    def __init__(self, bundle: Bundle, settings: Mapping[str, str]) -> None:
        super().__init__(bundle, settings)
        self._sensors: Any = None
        self._moves = False
        """Whether the robot follows set points."""

    def outcome(self) -> bool | None:
        known: bool | None = self._sensors.outcome()
        return known

    def close(self) -> None:
        if self._sensors is not None:
            self._sensors.close()

    def wrong_tool(self, name: str, told: Array, own: Array, remedy: str) -> Fault:
        """The fault of a controller whose tool centre point is not that of the bundle."""
        places = f"is at {told.round(3).tolist()}, joints and bundle say {own.round(3).tolist()}"
        return Fault("wrong robot", f"its {name} {places}; {remedy}")


class Sensors:
    """Reads gripper and cameras in a thread.

    Args:
        perception: HOST:PORT of the source of measured fields, see docs/deploy.md; empty: none.
        gripper: gets an opening for the gripper, or None for no command, and returns its opening; 0 closed, 1
            open. It raises OSError, ValueError or IndexError if the gripper does not answer. None: no gripper.
    """

    def __init__(self, perception: str, gripper: Callable[[float | None], float] | None) -> None:
        self.opening, self.measured = 0.0, dict[str, Array]()
        self.wanted: float | None = None
        """Commanded opening of the gripper."""
        self._gripper = gripper
        self._failed: Fault | None = None
        self._ended = threading.Event()
        self._perception = Channel(perception) if perception else None
        self._thread = threading.Thread(target=self._ask, daemon=True)
        self._thread.start()

    def _ask(self) -> None:
        told: float | None = None
        try:
            while not self._ended.wait(1 / RATE):
                if self._gripper is not None:
                    wanted = self.wanted
                    self.opening = self._gripper(wanted if wanted != told else None)
                    told = wanted
                if self._perception is not None:
                    answer = self._perception.ask(do="measured")["measured"]
                    self.measured = {name: np.array(values) for name, values in answer.items()}
        except (OSError, ValueError, IndexError):
            self._failed = Fault("connection lost", "the gripper does not answer")
        except Fault as fault:
            self._failed = fault

    def check(self) -> None:
        """Raise Fault if gripper or cameras have failed."""
        if self._failed is not None:
            raise self._failed

    def begin(self, episode: int) -> list[float] | None:
        """Begin an episode. Returns its goal, if the cameras know one."""
        goal: list[float] | None = None
        if self._perception is not None:
            goal = self._perception.ask(do="begin", episode=episode).get("goal")
        return goal

    def outcome(self) -> bool | None:
        """Whether the episode ends in success, if the cameras know."""
        return None if self._perception is None else self._perception.ask(do="outcome").get("success")

    def close(self) -> None:
        """Stop reading."""
        self._ended.set()
        self._thread.join(1.0)
        if self._perception is not None:
            self._perception.close()
