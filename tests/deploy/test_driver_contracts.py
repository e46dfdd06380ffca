"""The contracts of drivers find the drivers that break a promise."""

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from karolos_deploy import Bundle, Reading, SetPoint, contracts
from karolos_deploy.drivers import Driver
from support.drivers import Obedient

pytestmark = pytest.mark.xdist_group("bundle")


class Good(Obedient):
    """It keeps every promise, in a clock of its own."""

    settings: ClassVar[Mapping[str, str]] = {"fault": ""}
    here = True

    def connect(self) -> dict[str, Any]:
        return {"name": "ur5", "joints": 6}

    def begin(self, episode: int, *, move: bool) -> list[float] | None:
        super().begin(episode, move=move)
        self.moves = move
        return None

    def read(self) -> Reading | None:
        return super().read() if self.here else None

    def send(self, point: SetPoint) -> None:
        if self.moves:
            super().send(replace(point, positions=np.array(point.positions)))

    def stop(self) -> None:
        self.moves, self.speed = False, np.zeros(6)


class Parrot(Good):
    def connect(self) -> dict[str, Any]:
        return dict(self.bundle.contract["robot"])


class Deaf(Good):
    def __init__(self, bundle: Bundle, settings: Mapping[str, str]) -> None:
        self.bundle, self.values = bundle, {"fault": ""}


class Unstoppable(Good):
    def stop(self) -> None:
        self.speed = np.zeros(6)


class Idle(Good):
    def send(self, point: SetPoint) -> None: ...


class Wandering(Good):
    def read(self) -> Reading | None:
        self.told.append(self.told[-1] + 1e-3)
        return super().read()


class Altering(Good):
    """Each of its readings has other values in some fields."""

    fields: ClassVar[dict[str, Any]] = {}

    def read(self) -> Reading | None:
        reading = super().read()
        return replace(reading, **self.fields) if reading else None


class Repeating(Altering):
    fields: ClassVar[dict[str, Any]] = {"time": 1.0}


class Infinite(Altering):
    fields: ClassVar[dict[str, Any]] = {"wrench": np.full(6, np.inf)}


class Blind(Altering):
    fields: ClassVar[dict[str, Any]] = {"measured": {}}


class Waiting(Good):
    def read(self) -> Reading | None:
        time.sleep(0.009)
        return super().read()


class Early(Good):
    def wait(self, until: float) -> None:
        self.time += 0.9 * (until - self.time)


class Unaware(Good):
    def read(self) -> Reading | None:
        return Obedient.read(self)


class Failing(Good):
    def close(self) -> None:
        raise OSError


BROKEN = {
    Parrot: "another_robot_is_refused: it takes a bundle of another robot",
    Deaf: "unknown_settings_are_refused: it takes the setting",
    Unstoppable: "nothing_moves_after_stop: it moves by",
    Idle: "set_points_are_followed: it does not move",
    Wandering: "readings_are_whole_and_new: it moves by",
    Repeating: "readings_are_whole_and_new: 1 new readings",
    Infinite: "readings_are_whole_and_new: not a number",
    Blind: "readings_are_whole_and_new: not measured: no camera or fixture gives object_position",
    Waiting: "readings_are_whole_and_new: `read` takes",
    Early: "the_clock_goes_on: `wait` does not return",
    Unaware: "a_lost_connection_is_a_fault: a lost connection is not noticed",
    Failing: "stop_and_close_never_raise: OSError",
}


def broken(driver: type[Driver], bundle: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(contracts, "find", lambda _: driver)
    try:
        contracts.check("mine", bundle, {}, lose=lambda one: setattr(one, "here", False))
    except AssertionError as error:
        return str(error)
    return ""


def test_a_driver_that_keeps_every_promise_passes(whole, monkeypatch):
    assert not broken(Good, whole, monkeypatch)


@pytest.mark.parametrize("driver", BROKEN, ids=lambda one: one.__name__)
def test_a_broken_promise_is_named_in_a_line(driver, whole, monkeypatch):
    monkeypatch.setattr(contracts, "PROMISES", [getattr(contracts, BROKEN[driver].partition(":")[0])])
    found = broken(driver, whole, monkeypatch)
    assert any(line.startswith(BROKEN[driver]) for line in found.splitlines()), found
