"""A driver for tests, in place of a robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from karolos_deploy import Reading, SetPoint
from karolos_deploy.drivers import Driver

BROKEN = 63
"""Cycle from which a robot fails: after half a second."""
DOWN = np.array([0, 1.5, 0, 0, 0, 0])
"""rad/s with which an arm sinks."""


class Obedient(Driver):
    """A robot that is where it was told to be, in a clock of its own; from the cycle `BROKEN` on it fails."""

    settings: ClassVar[Mapping[str, str]] = {"fault": ""}
    failing: ClassVar[dict[str, Callable[[Reading], Reading | None]]] = {
        "late reading": lambda _: None,
        "stale clock": lambda reading: replace(reading, time=100.5),
        "not a number": lambda reading: replace(reading, velocities=reading.velocities * np.nan),
        "jump": lambda reading: replace(reading, positions=reading.positions + 0.4),
        "out of workspace": lambda one: replace(one, positions=one.positions + (one.time - 100.5) * DOWN),
        "force": lambda reading: replace(reading, wrench=np.array([0, 0, 400.0, 0, 0, 0])),
        "protective stop": lambda reading: replace(reading, state="protective stop"),
        "emergency stop": lambda reading: replace(reading, state="emergency stop"),
        "wrong size": lambda reading: replace(reading, positions=reading.positions[:5]),
        "controller restarted": lambda reading: replace(reading, time=reading.time - 50),
    }  # fmt: skip
    identities: ClassVar[dict[str, dict[str, Any]]] = {
        "wrong robot": {"name": "ur10"},
        "wrong payload": {"payload": 3.5},
    }

    def connect(self) -> dict[str, Any]:
        known = {**self.bundle.contract["robot"], "joints": 6}
        return known | self.identities.get(self.values["fault"], {})

    def begin(self, episode: int, *, move: bool) -> list[float] | None:
        logged = self.bundle.episode()
        self.seen = {name: logged[f"measured_{name}"][0] for name in self.measured}
        self.told = [np.array([joint["home"] for joint in self.bundle.contract["joints"]])]
        self.time, self.sent, self.stops = 100.0, [], 0
        self.speed = np.zeros(6)
        return None

    @property
    def measured(self) -> list[str]:
        return [one["name"] for one in self.bundle.contract["observation"] if one["formula"] == "measured"]

    def now(self) -> float:
        return self.time

    def wait(self, until: float) -> None:
        self.time = until

    def read(self) -> Reading | None:
        reading = Reading(self.time, self.told[-1], self.speed, np.zeros(6), 1.0, self.seen)
        if len(self.sent) < BROKEN or self.values["fault"] not in self.failing:
            return reading
        return self.failing[self.values["fault"]](reading)

    def send(self, point: SetPoint) -> None:
        assert point.positions is not None
        assert point.velocities is not None
        assert not self.stops
        self.sent.append(point)
        self.told.append(point.positions)
        self.speed = point.velocities

    def stop(self) -> None:
        self.stops += 1
