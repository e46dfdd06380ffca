"""The bar of a run: what it does, how far it is, and the time left."""

from __future__ import annotations

import io

from karolos_cli.display import Live

from karolos.experiment.events import RunAdvanced, RunBusy, RunEnded, RunStarted


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
