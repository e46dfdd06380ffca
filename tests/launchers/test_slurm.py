"""Runs as jobs of a stand-in for Slurm (support/fake_slurm.py): the script, the requeue, a second driver."""

import os
import random
import signal
import sys
import threading
from pathlib import Path

import pytest
from pydantic import ValidationError
from support import fake_slurm
from support.processes import wait_for
from support.toy_runs import created, toy

from karolos.errors import MachineError
from karolos.launchers.experiment import Experiment
from karolos.launchers.slurm import SlurmLauncher
from karolos.records import RunFolder

TOY = toy(training={"steps": 600}, testing={"interval": 100})
SHORT = toy(training={"steps": 200}, testing={"interval": 100})


@pytest.fixture
def slurm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder with the tasks' processes."""
    programs, state = tmp_path / "bin", tmp_path / "state"
    programs.mkdir()
    state.mkdir()
    for name in ("sbatch", "squeue", "scancel", "scontrol"):
        (programs / name).write_text(f"#!{sys.executable} -IS\n{Path(fake_slurm.__file__).read_text()}")
        (programs / name).chmod(0o755)
    monkeypatch.setenv("FAKE_SLURM", str(state))
    monkeypatch.setenv("PATH", f"{programs}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setattr(SlurmLauncher, "poll_seconds", 0.2)
    return state


def process_of(task: Path) -> int | None:
    """The run's process that a task's script has started."""
    try:
        script = task.read_text().split()[0]
        for child in Path(f"/proc/{script}/task/{script}/children").read_text().split():
            if b"karolos.experiment.process" in Path(f"/proc/{child}/cmdline").read_bytes():
                return int(child)
    except (OSError, IndexError):
        pass  # it has not begun
    return None


def test_a_run_that_reaches_its_time_limit_is_queued_again_and_equals_an_undisturbed_one(tmp_path, slurm):
    runs = tmp_path / "runs"

    def reach_time_limit() -> None:
        process = wait_for(lambda: process_of(slurm / "1_0"))
        os.kill(process, signal.SIGUSR1)  # which kills it, because it has not begun
        wait_for(lambda: list(runs.glob("toy-s0-*/tests.jsonl")))
        os.kill(int((slurm / "1_0").read_text().split()[0]), signal.SIGUSR1)

    limit = threading.Thread(target=reach_time_limit)
    limit.start()
    outcome = Experiment(TOY | {"launcher": "slurm"}).run(runs, check=False)
    limit.join()
    assert [(run.state, run.attempt) for run in outcome.runs] == [("finished", 2)]
    (undisturbed,) = Experiment(TOY).run(tmp_path / "undisturbed").runs
    tests, same = (RunFolder.open(run.folder).tests() for run in (outcome.runs[0], undisturbed))
    assert [(test.steps, test.returns) for test in tests] == [(test.steps, test.returns) for test in same]


def test_a_second_driver_follows_the_jobs_of_the_first(tmp_path, slurm):
    folder = created(TOY | {"training": TOY["training"] | {"steps": 10**6}}, tmp_path / "runs")
    first, second = SlurmLauncher(SlurmLauncher.Settings()), SlurmLauncher(SlurmLauncher.Settings())
    first.start(folder.path)
    assert first.wait(0.1) is None
    second.start(folder.path)
    assert second.wait(0.1) is None
    assert [path.name for path in slurm.iterdir()] == ["1_0"]
    folder.stop.write_text("enough")
    assert wait_for(lambda: second.wait(0.2)).folder == folder.path
    assert folder.state().state in ("stopped", "created")


def test_a_command_that_gives_up_leaves_the_jobs_alone_and_odd_answers_of_squeue_cost_no_run(
    tmp_path, slurm, monkeypatch
):
    troubles = tmp_path / "troubles"
    troubles.write_text("fine\nfail")
    with monkeypatch.context() as patch:
        patch.setattr("karolos.launchers.slurm.PATIENCE_SECONDS", 0.3)
        with pytest.raises(MachineError, match=r"squeue has failed .* Unable to contact .* --resume follows"):
            Experiment(SHORT | {"launcher": "slurm"}).run(tmp_path / "runs")
    assert not (tmp_path / "cancelled").exists()
    draw = random.Random(0)
    troubles.write_text("\n".join(draw.choices(["fail", "", "slurm: a message of the site", "fine"], k=300)))
    again = Experiment(SHORT | {"launcher": "slurm"}).run(tmp_path / "runs", existing="resume")
    assert len(troubles.read_text().splitlines()) < 300, "some of them were given"
    assert [(run.state, run.attempt) for run in again.runs] == [("finished", 1)]
    assert len({path.name.split("_")[0] for path in slurm.iterdir()}) == 1, "nothing is submitted twice"
    assert not (tmp_path / "cancelled").exists()


def test_output_of_sbatch_without_a_number_is_shown(tmp_path, slurm):
    (tmp_path / "banner").write_text("Welcome to the cluster")
    with pytest.raises(MachineError, match="sbatch did not print the number of a job, but 'Welcome to the cluster'"):
        Experiment(SHORT | {"launcher": "slurm"}).run(tmp_path / "runs")


@pytest.mark.parametrize("option", ["--array=0-3", "-a0-3", "--arr", "--requeue", "--time=9", "-t9"])
def test_options_of_sbatch_that_karolos_sets_are_refused_and_others_are_not(option):
    with pytest.raises(ValidationError, match=f"karolos sets {option.partition('=')[0]} itself"):
        SlurmLauncher.Settings(time="1:00", options=("--account=me", option))
    assert SlurmLauncher.Settings(options=("-A", "me", "--gres=gpu:1", "--gpus=a100:1", "--time=9"))


def test_without_slurm_the_missing_command_is_named(monkeypatch):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(MachineError, match="squeue is not installed"):
        SlurmLauncher(SlurmLauncher.Settings())


def test_a_command_that_fails_or_cannot_be_run_is_named(slurm, tmp_path):
    squeue = tmp_path / "bin" / "squeue"
    for text, told in (("#!/bin/sh\nexit 3\n", "squeue ended with exit code 3$"), ("?", "squeue cannot be run: Exec")):
        squeue.write_text(text)
        with pytest.raises(MachineError, match=told):
            SlurmLauncher(SlurmLauncher.Settings())
