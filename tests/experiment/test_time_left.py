"""The estimate of the time left: training, and the tests that it does not cover."""

from __future__ import annotations

import itertools

import pytest

from karolos.experiment import announcer as announcing
from karolos.experiment.announcer import Announcer
from karolos.experiment.events import RunAdvanced, RunBusy
from karolos.training.training import Progress


def test_estimate_follows_the_speed_of_training_and_adds_the_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = itertools.count(1)
    monkeypatch.setattr(announcing.time, "monotonic", lambda: float(next(clock)))
    events: list[RunAdvanced] = []
    announcer = Announcer("run", 1000, events.append)
    announcer.seconds_left = lambda training, steps: training + steps / 10
    for steps, seconds, warming_up in ((50, 0.1, True), (100, 1.0, False), (200, 3.0, False)):
        announcer.progressed(Progress(steps, 0, 0, seconds, warming_up))
    assert [event.seconds_left for event in events] == [None, None, pytest.approx(800 * 0.02 + 80)]


def test_time_left_is_told_during_the_tests_after_training() -> None:
    events: list[RunBusy] = []
    announcer = Announcer("run", 1000, lambda event: events.append(event) if isinstance(event, RunBusy) else None)
    announcer.seconds_left = lambda training, steps: training + steps + 30
    announcer.progressed(Progress(996, 0, 0, 1.0, False))
    announcer.announce("testing", 0, 100)
    announcer.progressed(Progress(1000, 0, 0, 1.1, False))
    announcer.announce("testing", 100, 100)
    assert [event.seconds_left for event in events] == [None, 30]
