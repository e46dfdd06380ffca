"""What killed processes leave behind, and folders whose content is crafted."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support.toy_runs import TOY

from karolos.errors import RunError
from karolos.evaluation.policies import load_agent
from karolos.launchers.experiment import Experiment, resume_run
from karolos.records import RunFolder, checkpoint, scan
from karolos.records.run_folder import remove_lost_leftovers
from karolos.store import Store
from karolos.system import is_alive
from karolos.system.files import locked

pytestmark = pytest.mark.xdist_group(__name__)


@pytest.fixture
def dead() -> int:
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        pass
    assert not is_alive(process.pid)
    return process.pid


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(Experiment(TOY).run(tmp_path_factory.mktemp("runs")).runs[0].folder)


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> RunFolder:
    return RunFolder.open(shutil.copytree(made, tmp_path / made.name))


def crafted(folder: RunFolder, name: str, change: Callable[[dict[str, Any], dict[str, Any]], object]) -> None:
    """Write a checkpoint again, with another content."""
    parts, meta = checkpoint.load(folder.checkpoints, name)
    change(parts, meta)
    checkpoint.save(folder.checkpoints, name, parts, meta)


UNFIT = "does not fit the run's spec"


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda parts, _: parts.pop("agent"), "it lacks agent"),
        (lambda parts, _: parts["agent"].clear(), UNFIT),
        (lambda parts, _: parts["agent"].pop("policy"), UNFIT),
        (lambda parts, _: parts["agent"].update(dict.fromkeys(parts["agent"], 5)), UNFIT),
        (lambda _, meta: meta.pop("steps"), UNFIT),
        (lambda _, meta: meta.update(seconds="long"), UNFIT),
    ],
)
def test_a_crafted_checkpoint_is_one_clear_error_to_who_plays_it_or_starts_from_it(folder, change, expected):
    crafted(folder, "best", change)
    with pytest.raises(RunError, match=expected) as caught:
        load_agent(folder, "best")
    assert "\n" not in str(caught.value)
    spec = TOY | {"agent": TOY["agent"] | {"start_from": str(folder.path)}}
    with pytest.raises(RunError, match=expected):  # before or while it starts
        Experiment(spec).run(folder.path.parent)
    assert not any(event.get("traceback") for one in scan(folder.path.parent) for event in one.events())


@pytest.mark.parametrize(
    "change", [lambda _, meta: meta.pop("updates"), lambda _, meta: meta.update(episodes_bytes="1")]
)
def test_a_crafted_checkpoint_is_not_resumed(folder, change):
    crafted(folder, "last", change)
    folder.set_state("running")
    with pytest.raises(RunError, match="as whole numbers"):
        resume_run(folder, Store.default_url(folder.path.parent))


PENDING = {"steps": 9, "updates": 1, "seconds": 1.0, "seeds": [1], "agent": {}}
INNER: dict[str, Callable[[dict[str, Any]], object]] = {
    "no tests": lambda parts: parts["run"].pop("tests"),
    "a text for the best": lambda parts: parts["run"].update(best=["much"]),
    "a test without its steps": lambda parts: parts["run"].update(tests=[{"seeds": [1]}]),
    "a test of another agent": lambda parts: parts["run"].update(tests=[PENDING]),
    "no episodes": lambda parts: parts["training"].pop("running"),
    "a count of more than 64 bits": lambda parts: parts["training"].update(updates=10**30),
    "a list for a generator": lambda parts: parts["training"].update(warmup=[1]),
    "no table": lambda parts: parts["buffer"]["storage"].pop("table"),
    "a number for the noise": lambda parts: parts["agent"]["noise"].update(memory=5.0),
    "no optimisers": lambda parts: parts["agent"].pop("optimisers"),
}


@pytest.mark.parametrize("case", INNER)
def test_a_crafted_content_of_a_checkpoint_is_one_clear_error_at_resume(folder, case):
    crafted(folder, "last", lambda parts, _: INNER[case](parts))
    folder.set_state("running")
    (run,) = resume_run(folder, Store.default_url(folder.path.parent)).runs
    assert run.state == "failed"
    assert run.error is not None
    assert "its content does not fit the run's spec" in run.error
    assert str(folder.checkpoints) in run.error
    assert folder.events()[-1].get("traceback") is None


def test_the_next_start_removes_what_killed_processes_left_in_runs_that_nobody_resumes(folder, dead):
    runs = folder.path.parent
    ours = folder.path / f".state.json.{dead}.tmp"
    ours.write_text("{")
    unpacked, imported = runs / ".import-killed", runs / ".import-running"
    for path in (unpacked, imported):
        path.mkdir()
        (path / ".lock").touch()
    with locked(imported / ".lock"):
        Experiment(TOY | {"training": TOY["training"] | {"steps": 2}}).run(runs)
    assert not ours.exists()
    assert not unpacked.exists()
    assert imported.exists()


def test_the_start_of_a_run_removes_what_its_killed_process_left_and_files_of_a_run_that_goes_on_stay(folder, dead):
    ours = folder.path / f".state.json.{dead}.tmp"
    others = folder.path / f".labels.json.{os.getpid()}.tmp"
    for path in (ours, others):
        path.write_text("{")
    folder.lock()
    assert not ours.exists()
    ours.write_text("{")
    remove_lost_leftovers(folder.path.parent)
    assert ours.exists()
    folder.release()
    remove_lost_leftovers(folder.path.parent)
    assert not ours.exists()
    assert others.exists()
