"""The bar of a run: what it does, and how far it is."""

import io
import re

import pytest
from karolos_cli.display import Live, Plain
from support.commands import Terminal
from support.run_samples import result

from karolos.experiment.events import RunAdvanced, RunBusy, RunEnded, RunEvent, RunStarted, RunTested


def last_line(width: int, *events: RunEvent) -> str:
    """The line of the run after these events, in a terminal of this width."""
    screen = Terminal()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", str(width))
        patch.setenv("TERM", "xterm")
        with Live(screen) as live:
            for event in events:
                live(event)
    line = [line for line in re.split(r"[\r\n]", screen.text()) if line.startswith("seed")][-1]
    return re.sub(r" +[-\d]:[-\d:]+ left *$", "", line)


STARTED = RunStarted("run", 0, 6000, "runs/run")
TESTED = RunTested("run", result(5000, 100, 100))


def test_bar_says_what_a_run_does_besides_training():
    trained = RunAdvanced("run", 100, 10, 2, 1.0, False)
    for events, end in (
        ([RunBusy("run", "collecting demonstrations", 12, 100)], "starting collecting demonstrations 12/100"),
        ([RunBusy("run", "testing", 100, 100), trained], "100/6000"),
        ([RunBusy("run", "testing", 37, 100), trained], "testing 37/100"),
        ([RunBusy("run", "checkpoint", 0, 1)], "starting checkpoint"),
        ([trained, RunBusy("run", "final test", 100, 1000)], "100/6000 final test 100/1000"),
        ([trained, RunEnded("run", "finished")], "finished"),
    ):
        assert re.sub(" +", " ", last_line(200, STARTED, *events)).endswith(end)


def test_a_line_has_the_speed_since_the_line_before():
    screen = io.StringIO()
    plain = Plain(screen)
    for event in (
        *(RunAdvanced("run", 100 * second, 10 * second, 1, float(second), False) for second in range(11)),
        TESTED,
        *(RunAdvanced("run", 1000 + 50 * second, 100, 1, 10.0 + second, True) for second in range(1, 101)),
        TESTED,
    ):
        plain(event)
    speeds = [line.rpartition("(")[2] for line in screen.getvalue().splitlines()]
    assert speeds == ["100 steps/s, 10 updates/s)", "50 steps/s, warm-up)"]


def test_a_log_says_every_five_seconds_how_far_a_run_is_before_its_first_test(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr("karolos_cli.display.time.monotonic", lambda: clock[0])
    screen = io.StringIO()
    plain = Plain(screen)
    plain(STARTED)
    for second in range(1, 16):
        clock[0] = float(second)
        advanced = RunAdvanced("run", 100 * second, 10 * second, 1, float(second), False)
        plain(RunBusy("run", "testing", second, 100) if second > 10 else advanced)
    assert screen.getvalue().splitlines()[1:] == [
        "run at 500 of 6,000 steps, 5.0 s (100 steps/s, 10 updates/s)",
        "run at 1,000 of 6,000 steps, 10.0 s (100 steps/s, 10 updates/s)",
        "run at 1,000 of 6,000 steps, 10.0 s (testing 15/100)",
    ]


def test_bar_fits_a_narrow_terminal():
    advanced = [RunAdvanced("run", steps, 2650, 100, steps / 290, False) for steps in (5000, 5296)]
    line = last_line(80, STARTED, *advanced, TESTED, RunBusy("run", "testing", 37, 100))
    assert len(line) <= 80
    assert re.fullmatch(r"seed 0 [━╸╺]{12} 5296/6000 290 steps/s testing 37/100 end 1.00", line), line
