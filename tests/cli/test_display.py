"""The bar of a run: what it does, how far it is, and the time left."""

from __future__ import annotations

import io
import re

import pytest
from karolos_cli.display import Live
from support.commands import Terminal

from karolos.experiment.events import RunAdvanced, RunBusy, RunEnded, RunStarted, RunTested
from karolos.records.results import TestResult


def test_bar_says_what_a_run_does_besides_training_and_the_time_left_with_tests() -> None:
    with Live(io.StringIO()) as live:

        def fields() -> tuple[str, str]:
            (task,) = live._bars.tasks
            return task.fields["activity"], task.fields["left"]

        live(RunStarted("run", 0, 1000, "runs/run"))
        live(RunBusy("run", "collecting demonstrations", 12, 100))
        assert fields() == ("collecting demonstrations 12/100", "")
        live(RunBusy("run", "collecting demonstrations", 100, 100))
        live(RunAdvanced("run", 100, 10, 2, 1.0, False, 83.4))
        assert fields() == ("", "0:01:23 left")
        live(RunBusy("run", "testing", 37, 100))
        live(RunAdvanced("run", 108, 11, 2, 1.1, False, 83.0))
        assert fields() == ("testing 37/100", "0:01:23 left")
        live(RunBusy("run", "testing", 100, 100))
        live(RunBusy("run", "checkpoint", 0, 1))
        assert fields()[0] == "checkpoint"
        live(RunBusy("run", "checkpoint", 1, 1))
        live(RunBusy("run", "final test", 100, 1000, 61.2))
        assert fields() == ("final test 100/1000", "0:01:01 left")
        assert live._bars.tasks[0].fields["speed"] == "", "training is over"
        live(RunEnded("run", "finished"))
        assert fields() == ("", "")


def test_bar_fits_a_narrow_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "xterm")
    screen = Terminal()
    flags = (True,) * 100
    with Live(screen) as live:
        live(RunStarted("run", 0, 6000, "runs/run"))
        for steps in (5000, 5296):
            live(RunAdvanced("run", steps, 2650, 100, steps / 290, False, 3.0))
        live(RunTested("run", TestResult(5000, 17.0, flags, flags, flags, (-7.5,) * 100, (50,) * 100)))
        live(RunBusy("run", "testing", 37, 100))
        live._bars.refresh()
    text = screen.text()
    line = next(line for line in text.splitlines() if "testing" in line)
    assert len(line) <= 80
    assert re.fullmatch(r"seed 0 [━╸╺]{12} 5296/6000 290 steps/s testing 37/100 end 1.00 0:00:03 left *", line), line
