"""Seeds without a finished run, and a database that cannot be reached while an experiment goes on."""

import os
import signal
from pathlib import Path

import pytest
from support.fake_launcher import FakeLauncher
from support.processes import holders
from support.toy_runs import TOY, toy

from karolos.errors import RunError
from karolos.experiment.events import RunAdvanced, RunEnded, RunStarted, RunWarned
from karolos.launchers.experiment import Experiment
from karolos.store import Store, check, reindex


def test_a_killed_process_of_a_seed_is_a_lost_run_and_an_error(tmp_path):
    spec = toy(seeds=[0, 1], training={"steps": 100_000}, testing={"interval": 100_000})
    killed, ended = [], []

    def listen(event: object) -> None:
        if isinstance(event, RunAdvanced) and event.run not in killed:
            killed.append(event.run)
            (process,) = holders([tmp_path / event.run / "lock"])
            os.kill(process, signal.SIGKILL)
        if isinstance(event, RunEnded):
            ended.append(event)

    outcome = Experiment(spec).run(tmp_path, jobs=2, listener=listen, check=False)
    assert [(run.seed, run.state) for run in outcome.runs] == [(0, "lost"), (1, "lost")]
    assert all(run.error == "its process was killed by SIGKILL" for run in outcome.runs)
    assert outcome.exit_code == 1
    assert {(event.state, event.error) for event in ended} == {("lost", "its process was killed by SIGKILL")}
    with pytest.raises(RunError, match="its process was killed by SIGKILL"):
        outcome.check()


class Outage:
    """A listener that takes the database away, and gives it back. It keeps the warnings."""

    def __init__(self, runs: Path) -> None:
        self.file, self.aside = runs / "karolos.sqlite", runs / "aside"
        self.warned: list[RunWarned] = []
        self.ended: list[RunEnded] = []

    def begin(self) -> None:
        self.file.rename(self.aside)
        self.file.mkdir()

    def end(self) -> None:
        self.file.rmdir()
        self.aside.rename(self.file)

    def __call__(self, event: object) -> None:
        if isinstance(event, RunWarned):
            self.warned.append(event)
        if isinstance(event, RunEnded):
            self.ended.append(event)
            if len(self.ended) == 1:
                self.begin()
            if len(self.ended) == 2:
                self.end()


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_database_that_cannot_be_reached_between_seeds_costs_a_warning_and_no_seed(jobs, tmp_path, monkeypatch):
    monkeypatch.setattr("karolos.launchers.experiment.make_launcher", lambda *_: FakeLauncher())  # for two jobs
    outage = Outage(tmp_path)
    outcome = Experiment(TOY | {"seeds": [0, 1, 2]}).run(tmp_path, jobs=jobs, listener=outage)
    assert outcome.exit_code == 0
    assert [event.state for event in outage.ended] == ["finished"] * 3
    assert any("its folder is complete" in event.warning for event in outage.warned)
    if jobs == 1:
        assert {event.run for event in outage.warned} == {outage.ended[1].run}
    with Store(Store.default_url(tmp_path)) as store:
        assert outage.ended[2].run in {run.run for run in store.runs()}
        if jobs == 1:
            assert [found.run for found in check(store, tmp_path)] == [outage.ended[1].run]
        assert reindex(store, tmp_path).problems == ()
        assert list(check(store, tmp_path)) == []
        assert sorted(run.seed for run in store.runs()) == [0, 1, 2]


def test_a_run_is_entered_whole_as_soon_as_the_database_is_back(tmp_path):
    outage = Outage(tmp_path)

    def listen(event: object) -> None:
        if isinstance(event, RunStarted):
            outage.begin()
        if isinstance(event, RunAdvanced) and outage.aside.exists():
            outage.end()

    outcome = Experiment(TOY).run(tmp_path, listener=listen)
    with Store(Store.default_url(tmp_path)) as store:
        assert store.runs() == outcome.runs
        assert list(check(store, tmp_path)) == []
