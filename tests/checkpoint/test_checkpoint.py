from __future__ import annotations

import errno
import importlib
import os
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from support.checkpoint_samples import META, PARTS
from support.states import same

from karolos import checkpoint
from karolos.checkpoint import load, save
from karolos.errors import MachineError, UsageError


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    return save(tmp_path, "best", PARTS, META)


def test_new_checkpoint_takes_the_place_of_the_old_one(tmp_path: Path) -> None:
    save(tmp_path, "best", PARTS, {"steps": 1})
    save(tmp_path, "best", {"agent": {}}, {"steps": 2})
    assert load(tmp_path, "best") == ({"agent": {}}, {"steps": 2})
    assert [path.name for path in tmp_path.iterdir()] == ["best"]
    assert checkpoint.names(tmp_path) == ("best",)


def test_a_part_comes_with_the_digest_of_the_checkpoint_that_it_was_read_from(whole: Path, tmp_path: Path) -> None:
    parts, meta = load(tmp_path, "best")
    for part in PARTS:
        state, about, sha256 = checkpoint.load_part(tmp_path, "best", part)
        assert same(state, parts[part])
        assert (about, sha256) == (meta, checkpoint.digest(tmp_path, "best", part))
    with pytest.raises(checkpoint.CheckpointError, match="it lacks other"):
        checkpoint.load_part(tmp_path, "best", "other")


def test_loading_never_leaves_the_folder(tmp_path: Path) -> None:
    save(tmp_path, "best", PARTS, {})
    (tmp_path / "inner").mkdir()
    with pytest.raises(UsageError, match="leads out"):
        load(tmp_path / "inner", "../best")


def test_full_disk_keeps_the_old_checkpoint(whole: Path) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (500_000, limits[1]))
    try:
        with pytest.raises(MachineError, match="best: the disk is full; free some space; what was there before"):
            save(whole.parent, "best", {"agent": {"x": torch.rand(300_000)}}, {})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert same(load(whole.parent, "best")[0], PARTS)
    assert [path.name for path in whole.parent.iterdir()] == ["best"]


@pytest.mark.parametrize("calls", range(8))
def test_disk_that_fails_at_any_moment_keeps_a_whole_checkpoint(
    whole: Path, calls: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    left = calls
    fsync = os.fsync

    def fail_later(descriptor: int) -> None:
        nonlocal left
        if left == 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        left -= 1
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", fail_later)
    new = {"agent": {"x": 1}, "buffer": {"y": 2}}
    try:
        save(whole.parent, "best", new, {})
    except MachineError:
        pass
    else:
        assert left >= 0
    monkeypatch.undo()
    found = load(whole.parent, "best")[0]
    assert same(found, PARTS) or same(found, new)
    save(whole.parent, "best", new, {})
    assert same(load(whole.parent, "best")[0], new)
    assert [path.name for path in whole.parent.iterdir()] == ["best"]


KILLED = """
import os, signal, sys
from pathlib import Path
from karolos import checkpoint, system
folder, place = Path(sys.argv[1]), int(sys.argv[2])
rename = system.replace
def count_down(*arguments):
    global place
    if not arguments[0].is_dir():  # the manifest
        return rename(*arguments)
    if place == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    place -= 1
    return rename(*arguments)
system.replace = count_down
checkpoint.save(folder, "best", {"agent": {"x": 1}}, {"steps": 8})
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize(("place", "steps"), [(0, 7), (1, 7), (2, 8)])
def test_process_killed_between_renames_leaves_a_checkpoint(whole: Path, place: int, steps: int) -> None:
    command = [sys.executable, "-c", KILLED, str(whole.parent), str(place)]
    assert subprocess.run(command, check=False).returncode == -9
    assert load(whole.parent, "best")[1]["steps"] == steps
    assert checkpoint.names(whole.parent) == ("best",)
    assert checkpoint.read_meta(whole.parent, "best")["steps"] == steps
    save(whole.parent, "best", PARTS, {"steps": 9})
    assert load(whole.parent, "best")[1]["steps"] == 9
    assert [path.name for path in whole.parent.iterdir()] == ["best"]


@pytest.mark.parametrize("moment", ["folder.read_manifest", "state_file.unpack_state", "folder.read_state"])
def test_reader_of_a_run_that_goes_on_gets_the_old_or_the_new(
    whole: Path, moment: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    module, name = moment.split(".")
    home = importlib.import_module(f"karolos.checkpoint.{module}")
    function = getattr(home, name)
    new = {"agent": {"weight": torch.ones(3)}}

    def replaced_before(*arguments: Any) -> Any:
        monkeypatch.setattr(home, name, function)
        save(whole.parent, "best", new, {"steps": 8})
        return function(*arguments)

    monkeypatch.setattr(home, name, replaced_before)
    parts, meta = load(whole.parent, "best")
    assert meta == {"steps": 8}
    assert same(parts, new)
