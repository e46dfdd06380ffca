"""Gripper and cameras of drivers of real arms. They answer more slowly than the arm."""

from __future__ import annotations

import threading
import time
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
GRIPPER_LATE = 1.0
"""Largest age in s of the gripper's opening. Grippers tell it some times per second."""


def measured_of(answer: Mapping[str, Any]) -> dict[str, Array]:
    """The measured fields in an answer of the cameras. Raises Fault if it has none, or no numbers."""
    fields = answer.get("measured")
    if not isinstance(fields, dict):
        raise Fault("not measured", 'the cameras do not answer {"measured": {"NAME": [numbers]}}')
    found = {}
    for name, values in fields.items():
        try:
            found[name] = np.array(values, float)
        except (TypeError, ValueError, OverflowError):  # of a number of 400 digits
            raise Fault("not a number", f"{name} of the cameras is not a list of numbers") from None
    return found


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
    """Reads gripper and cameras in a thread each.

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
        self._told: float | None = None
        self._failed: Fault | None = None
        self._ended = threading.Event()
        self._perception = Channel(perception) if perception else None
        tasks = {"the cameras": self._see, "the gripper": self._grip}  # none waits for the other
        asked = zip(tasks, (self._perception, gripper), strict=True)
        self._heard = {name: time.perf_counter() for name, source in asked if source is not None}
        """Time of the newest data in s, by its source."""
        self._threads = [
            threading.Thread(target=self._repeat, args=(name, tasks[name]), daemon=True) for name in self._heard
        ]
        for thread in self._threads:
            thread.start()

    def _repeat(self, name: str, task: Callable[[], None]) -> None:
        try:
            while not self._ended.wait(1 / RATE):
                task()
                self._heard[name] = time.perf_counter()
        except Fault as fault:
            self._failed = fault

    def _grip(self) -> None:
        assert self._gripper is not None
        wanted = self.wanted
        try:
            self.opening = self._gripper(wanted if wanted != self._told else None)
        except (OSError, ValueError, IndexError):
            raise Fault("connection lost", "the gripper does not answer") from None
        self._told = wanted

    def _see(self) -> None:
        assert self._perception is not None
        self.measured = measured_of(self._perception.ask(do="measured"))

    def check(self, late: float) -> None:
        """Raise Fault if gripper or cameras have failed, or gave nothing new for `late` s (`GRIPPER_LATE`)."""
        if self._failed is not None:
            raise self._failed
        for name, heard in self._heard.items():
            age, most = time.perf_counter() - heard, max(late, GRIPPER_LATE) if name == "the gripper" else late
            if age > most:
                what = f"{name} gave nothing new for {1000 * age:.0f} ms, allowed are {1000 * most:.0f}"
                raise Fault("late reading", what)

    def begin(self, episode: int) -> list[float] | None:
        """Begin an episode. Returns its goal, if the cameras know one."""
        goal: list[float] | None = None
        if self._perception is not None:
            goal = self._perception.ask(do="begin", episode=episode).get("goal")
        return goal

    def outcome(self) -> bool | None:
        """Whether the episode ends in success, if the cameras know."""
        told = None if self._perception is None else self._perception.ask(do="outcome").get("success")
        if told not in (None, True, False):
            raise Fault("not measured", f"success is {told!r} for the cameras; it is true, false or null")
        return told

    def close(self) -> None:
        """Stop reading."""
        self._ended.set()
        for thread in self._threads:
            thread.join(1.0)
        if self._perception is not None:
            self._perception.close()
