"""The driver: jobs through a launcher, followed in their folders."""

from __future__ import annotations

import json
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from support import toy_runs
from support.fake_launcher import FakeLauncher

from karolos.experiment.driver import Driver, Existing, Feed, Follower, Job, create
from karolos.experiment.events import (
    RunAdvanced,
    RunBusy,
    RunEnded,
    RunEvent,
    RunFinalTested,
    RunStarted,
    RunTested,
    RunWarned,
)
from karolos.experiment.experiment import Experiment
from karolos.experiment.run_index import RunIndex
from karolos.experiment.signals import StopRequest
from karolos.experiment.worker import execute_folder
from karolos.files import write_json
from karolos.records import provenance
from karolos.spec import Spec, spec_from_dict
from karolos.store import Store, check

TOY = toy_runs.TOY | {
    "training": toy_runs.TOY["training"] | {"steps": 40},
    "testing": {"interval": 20, "episodes": 2},
}


def toy(**changes: Any) -> Spec:
    return spec_from_dict(TOY | changes)


def drive(
    runs: Path, launcher: FakeLauncher, feed: Feed, *, existing: Existing = "ignore", retries: int = 0
) -> list[RunEvent]:
    events: list[RunEvent] = []
    url = Store.default_url(runs)
    driver = Driver(launcher, runs, url, events.append, existing=existing, text="# mine\n", retries=retries)
    driver.run(feed, StopRequest())
    return events


def test_the_listener_hears_of_a_launched_run_what_it_hears_of_one_in_this_process(tmp_path: Path) -> None:
    here: list[RunEvent] = []
    Experiment(toy()).run(tmp_path / "here", listener=here.append)
    there = drive(tmp_path / "there", FakeLauncher(), Feed(Job(toy())))
    kinds = RunStarted, RunTested, RunFinalTested, RunWarned, RunEnded
    assert [type(event) for event in there if isinstance(event, kinds)] == [
        type(event) for event in here if isinstance(event, kinds)
    ]
    tests, same = ([event.result for event in one if isinstance(event, RunTested)] for one in (here, there))
    assert [(test.steps, test.end, test.returns) for test in tests] == [
        (test.steps, test.end, test.returns) for test in same
    ]


def test_a_run_that_waits_on_a_cluster_stands_in_the_index(tmp_path: Path) -> None:
    class Waiting(FakeLauncher):
        def start(self, folder: Path) -> None:
            with Store(Store.default_url(tmp_path)) as store:
                assert [(run.run, run.state) for run in store.runs()] == [(folder.name, "created")]
            super().start(folder)

    drive(tmp_path, Waiting(), Feed(Job(toy())))


def test_only_the_driver_indexes_and_the_index_equals_the_folders(tmp_path: Path) -> None:
    job = Job(toy(seeds=[0, 1]))
    drive(tmp_path, FakeLauncher(), Feed(job))
    with Store(Store.default_url(tmp_path)) as store:
        assert {run.run for run in store.runs()} == {summary.run for summary in job.summaries.values()}
        assert list(check(store, tmp_path)) == []
    assert job.finished
    assert [len(tests) for tests in job.results().values()] == [2, 2]


def test_a_run_whose_process_died_is_started_again_as_often_as_allowed(tmp_path: Path) -> None:
    job, launcher = Job(toy()), FakeLauncher(True, False)
    events = drive(tmp_path, launcher, Feed(job), retries=1)
    assert len(launcher.started) == 2
    assert len(set(launcher.started)) == 1, "the second process resumes the first one's run"
    assert job.finished
    assert sum(isinstance(event, RunEnded) for event in events) == 1


def test_a_run_whose_process_died_too_often_is_lost_and_the_other_seeds_go_on(tmp_path: Path) -> None:
    job = Job(toy(seeds=[0, 1]))
    events = drive(tmp_path, FakeLauncher(True), Feed(job))
    assert [job.summaries[seed].state for seed in (0, 1)] == ["lost", "finished"]
    assert job.summaries[0].error == job.error == "its process died"
    assert [event.error for event in events if isinstance(event, RunEnded)] == ["its process died", None]


def test_a_lost_run_stops_the_others_of_a_job_whose_runs_belong_together(tmp_path: Path) -> None:
    job, launcher = Job(toy(seeds=[0, 1]), together=True), FakeLauncher(True)
    drive(tmp_path, launcher, Feed(job))
    assert (job.halted, list(job.summaries)) == ("another run of this trial failed", [0])
    assert len(launcher.started) == 1


@pytest.fixture
def stopped(tmp_path: Path) -> Path:
    """A runs folder with a run that was stopped, and the reason."""
    with create(tmp_path, toy(), 0, None) as folder:
        folder.set_state("stopped")
        folder.event("stopped", steps=0, reason="SIGUSR1")
    return tmp_path


def test_a_stopped_run_whose_process_dies_before_it_resumes_is_not_at_an_end(stopped: Path) -> None:
    job, launcher = Job(toy()), FakeLauncher(True, False)
    drive(stopped, launcher, Feed(job), existing="resume", retries=1)
    assert len(launcher.started) == 2
    assert job.finished


@pytest.mark.parametrize("blind", [False, True])
def test_a_process_that_refuses_to_resume_a_stopped_run_says_why(
    stopped: Path, monkeypatch: pytest.MonkeyPatch, blind: bool
) -> None:
    job, launcher = Job(toy()), FakeLauncher(blind=blind)
    monkeypatch.setattr(provenance, "software", lambda: {"versions": provenance.versions() | {"torch": "1.0"}})
    events = drive(stopped, launcher, Feed(job), existing="resume", retries=3)
    assert len(launcher.started) == 1, "it would refuse again"
    assert f"would run other software: torch is {version('torch')} here and 1.0 there" in (job.error or "")
    assert [event.error for event in events if isinstance(event, RunEnded)] == [job.error]
    monkeypatch.undo()
    drive(stopped, FakeLauncher(blind=blind), Feed(job := Job(toy())), existing="resume")
    assert (job.finished, job.error) == (True, None)


@pytest.mark.parametrize(("existing", "started"), [("ignore", 2), ("skip", 1), ("resume", 1)])
def test_existing_runs_are_used_as_asked(tmp_path: Path, existing: Existing, started: int) -> None:
    drive(tmp_path, FakeLauncher(), Feed(Job(toy())))
    create(tmp_path, toy(seeds=[1]), 1, None).release()  # its process never started
    launcher, job = FakeLauncher(), Job(toy(seeds=[0, 1]))
    drive(tmp_path, launcher, Feed(job), existing=existing)
    assert len(launcher.started) == started
    assert job.finished
    assert len(list(tmp_path.glob("toy-s*"))) == 2 + (existing == "ignore") + (existing != "resume")


def test_a_run_that_is_halted_before_it_begins_is_not_executed(tmp_path: Path) -> None:
    folder = create(tmp_path, toy(), 0, None)
    folder.release()
    folder.stop.write_text("pruned")
    assert execute_folder(folder.path, 1) is None
    assert (folder.state().state, folder.events()) == ("created", ())


def test_a_damaged_folder_is_a_problem_and_not_an_end(tmp_path: Path) -> None:
    folder = create(tmp_path, toy(), 0, None)
    folder.release()
    (folder.path / "resolved.json").unlink()
    assert "name" in str(execute_folder(folder.path, 1))
    assert "not a run folder" in str(execute_folder(tmp_path / "missing", 1))


def test_a_process_with_other_software_refuses_and_says_what_differs(tmp_path: Path) -> None:
    folder = create(tmp_path, toy(), 0, None)
    folder.release()
    launch = {"versions": provenance.versions(), "source": provenance.source()}
    write_json(folder.launch, launch | {"versions": launch["versions"] | {"torch": "1.0"}})
    assert "torch is " in (problem := str(execute_folder(folder.path, 1)))
    assert "1.0 there" in problem
    write_json(folder.launch, launch | {"source": "0"})
    assert "the source of karolos or a plugin is another one" in str(execute_folder(folder.path, 1))
    write_json(folder.launch, launch)
    assert execute_folder(folder.path, 1) is None
    assert json.loads(folder.launch.read_text())["host"] == platform.node()


def test_the_follower_reports_only_what_is_new_and_whole(tmp_path: Path) -> None:
    folder = create(tmp_path, toy(), 0, None)
    folder.event("warning", error="old", consequence="none")
    follower = Follower(Job(toy()), 0, folder, RunIndex(None, folder))
    assert list(follower.events()) == []
    folder.event("started")
    folder.event("warning", error="new", consequence="none")
    folder.progress.write_text('{"RunBusy": {"run": "r", "activity": "testing", "done": 1, "total": 2}}')
    with (folder.path / "events.jsonl").open("a") as file:
        file.write('{"event": "warn')
    assert [type(event) for event in follower.events()] == [RunStarted, RunBusy, RunWarned]
    folder.progress.write_text('{"RunAdvanced": {"run": 1}}')
    assert list(follower.events()) == []
    assert not isinstance(next(iter(follower.events()), None), RunAdvanced)
