"""The driver: runs through a launcher, followed in their folders."""

import json
import platform
import shutil
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from support import toy_runs
from support.fake_launcher import FakeLauncher
from support.toy_runs import created

from karolos import registry
from karolos.errors import PluginError
from karolos.experiment.events import RunBusy, RunEnded, RunEvent, RunFinalTested, RunStarted, RunTested, RunWarned
from karolos.experiment.process import execute_folder
from karolos.experiment.signals import StopRequest
from karolos.launchers.driver import Driver
from karolos.launchers.experiment import Experiment
from karolos.launchers.runs import Existing, Home, RunJob
from karolos.records import provenance
from karolos.specification import Spec, spec_from_dict
from karolos.store import Store, check
from karolos.system.files import write_json

TOY = toy_runs.toy(training={"steps": 40}, testing={"interval": 20})


def toy(**changes: Any) -> Spec:
    return spec_from_dict(TOY | changes)


def drive(
    runs: Path, launcher: FakeLauncher, *, existing: Existing = "ignore", retries: int = 0, **job: Any
) -> tuple[RunJob, list[RunEvent]]:
    """The job, executed; and what the listener heard."""
    events: list[RunEvent] = []
    done = RunJob(job.pop("spec", toy()), Home(runs, Store.default_url(runs), existing), **job)
    Driver(launcher, events.append, StopRequest(), retries).run([done])
    return done, events


def test_the_listener_hears_of_a_launched_run_what_it_hears_of_one_in_this_process(tmp_path):
    here: list[RunEvent] = []
    Experiment(toy()).run(tmp_path / "here", listener=here.append)
    _, there = drive(tmp_path / "there", FakeLauncher())
    kinds = RunStarted, RunTested, RunFinalTested, RunWarned, RunEnded
    assert [type(event) for event in there if isinstance(event, kinds)] == [
        type(event) for event in here if isinstance(event, kinds)
    ]
    tests, same = ([event.result for event in one if isinstance(event, RunTested)] for one in (here, there))
    assert [(test.steps, test.end, test.returns) for test in tests] == [
        (test.steps, test.end, test.returns) for test in same
    ]


class Failing(FakeLauncher):
    def start(self, folder: Path) -> None:
        raise ZeroDivisionError(folder.name)


def test_the_error_of_another_packages_launcher_names_its_line(tmp_path, monkeypatch):
    entry = registry.PluginEntry("launchers", "failing", f"{__name__}:Failing", "shaky", "1.0")
    installed = *registry._installed(), entry
    monkeypatch.setattr(registry, "_scan", lambda: (installed, ()))
    with pytest.raises(PluginError, match=r"test_driver\.py:\d+: launcher 'failing' of shaky 1\.0: ZeroDivisionError"):
        drive(tmp_path, Failing())


def test_a_run_that_waits_on_a_cluster_stands_in_the_index(tmp_path):
    class Waiting(FakeLauncher):
        def start(self, folder: Path) -> None:
            with Store(Store.default_url(tmp_path)) as store:
                assert [(run.run, run.state) for run in store.runs()] == [(folder.name, "created")]
            super().start(folder)

    drive(tmp_path, Waiting())


def test_only_the_driver_indexes_and_the_index_equals_the_folders(tmp_path):
    job, _ = drive(tmp_path, FakeLauncher(), spec=toy(seeds=[0, 1]))
    with Store(Store.default_url(tmp_path)) as store:
        assert {run.run for run in store.runs()} == {summary.run for summary in job.summaries.values()}
        assert list(check(store, tmp_path)) == []
    assert job.finished
    assert [len(tests) for tests in job.results().values()] == [2, 2]


def test_a_run_whose_process_died_too_often_is_lost_and_the_other_seeds_go_on(tmp_path):
    job, events = drive(tmp_path, FakeLauncher(True), spec=toy(seeds=[0, 1]))
    assert [job.summaries[seed].state for seed in (0, 1)] == ["lost", "finished"]
    assert job.summaries[0].error == job.error == "its process died"
    assert [event.error for event in events if isinstance(event, RunEnded)] == ["its process died", None]


def test_a_run_that_is_removed_while_it_waits_is_lost_and_the_other_seeds_go_on(tmp_path):
    removed = created(TOY, tmp_path)

    class Removing(FakeLauncher):
        def room(self, waiting: int) -> int:
            shutil.rmtree(removed.path, ignore_errors=True)
            return super().room(waiting)

    job, _ = drive(tmp_path, Removing(), existing="resume", spec=toy(seeds=[0, 1]))
    assert [job.summaries[seed].state for seed in (0, 1)] == ["lost", "finished"]
    assert "was removed while it waited" in str(job.error)


def test_a_lost_run_stops_the_others_of_a_job_whose_runs_belong_together(tmp_path):
    launcher = FakeLauncher(True)
    job, _ = drive(tmp_path, launcher, spec=toy(seeds=[0, 1]), together=True)
    assert (job.halted, list(job.summaries)) == ("another run of this trial failed", [0])
    assert len(launcher.started) == 1


@pytest.fixture
def stopped(tmp_path: Path) -> Path:
    """A runs folder with a run that was stopped."""
    folder = created(TOY, tmp_path)
    folder.set_state("stopped")
    folder.event("stopped", steps=0, reason="SIGUSR1")
    return tmp_path


@pytest.mark.parametrize("existing", ["ignore", "resume"])
def test_a_run_whose_process_died_is_started_again_as_often_as_allowed(stopped, existing):
    """That the stopped run has ended before is no end of its new process."""
    launcher = FakeLauncher(True, False)
    job, events = drive(stopped, launcher, existing=existing, retries=1)
    assert len(launcher.started) == 2
    assert len(set(launcher.started)) == 1, "the second process resumes the first one's run"
    assert job.finished
    assert sum(isinstance(event, RunEnded) for event in events) == 1


@pytest.mark.parametrize("blind", [False, True])
def test_a_process_that_refuses_to_resume_a_stopped_run_says_why(stopped, monkeypatch, blind):
    launcher = FakeLauncher(blind=blind)
    monkeypatch.setattr(provenance, "software", lambda: {"versions": provenance.versions() | {"torch": "1.0"}})
    job, events = drive(stopped, launcher, existing="resume", retries=3)
    assert len(launcher.started) == 1, "it would refuse again"
    assert f"would run other software: torch is {version('torch')} here and 1.0 there" in (job.error or "")
    assert [event.error for event in events if isinstance(event, RunEnded)] == [job.error]
    monkeypatch.undo()
    job, _ = drive(stopped, FakeLauncher(blind=blind), existing="resume")
    assert (job.finished, job.error) == (True, None)


@pytest.mark.parametrize(("existing", "started"), [("ignore", 2), ("skip", 1), ("resume", 1)])
def test_existing_runs_are_used_as_asked(tmp_path, existing, started):
    drive(tmp_path, FakeLauncher())
    created(TOY, tmp_path, 1)  # its process never started
    launcher = FakeLauncher()
    job, _ = drive(tmp_path, launcher, existing=existing, spec=toy(seeds=[0, 1]))
    assert len(launcher.started) == started
    assert job.finished
    assert len(list(tmp_path.glob("toy-s*"))) == 2 + (existing == "ignore") + (existing != "resume")


def test_a_run_that_is_halted_before_it_begins_is_not_executed(tmp_path):
    folder = created(TOY, tmp_path)
    folder.stop.write_text("pruned")
    assert execute_folder(folder.path, 1) is None
    assert (folder.state().state, folder.events()) == ("created", ())


def test_a_damaged_folder_is_a_problem_and_not_an_end(tmp_path):
    folder = created(TOY, tmp_path)
    (folder.path / "resolved.json").unlink()
    assert "resolved.json" in str(execute_folder(folder.path, 1))
    assert "not a run folder" in str(execute_folder(tmp_path / "missing", 1))


def test_a_process_with_other_software_refuses_and_says_what_differs(tmp_path):
    folder = created(TOY, tmp_path)
    launch = provenance.software()
    write_json(folder.launch, launch | {"versions": launch["versions"] | {"torch": "1.0"}})
    assert "torch is " in (problem := str(execute_folder(folder.path, 1)))
    assert "1.0 there" in problem
    write_json(folder.launch, launch | {"sources": {"karolos": "0"}})
    assert "the source of karolos is another one" in str(execute_folder(folder.path, 1))
    write_json(folder.launch, launch)
    assert execute_folder(folder.path, 1) is None
    assert json.loads(folder.launch.read_text())["host"] == platform.node()


def test_only_what_is_new_and_whole_is_told(tmp_path):
    folder = created(TOY, tmp_path)
    folder.event("warning", error="old", consequence="none")
    [task] = RunJob(toy(), Home(tmp_path, Store.default_url(tmp_path), "resume")).tasks()
    task.begin()
    assert len(list(task.events())) == 1, "that it is launched"
    folder.event("started")
    folder.event("warning", error="new", consequence="none")
    folder.progress.write_text('{"RunBusy": {"run": "r", "activity": "testing", "done": 1, "total": 2}}')
    with (folder.path / "events.jsonl").open("a") as file:
        file.write('{"event": "warn')
    assert [type(event) for event in task.events()] == [RunStarted, RunBusy, RunWarned]
    folder.progress.write_text('{"RunAdvanced": {"run": 1}}')
    assert list(task.events()) == []
