import errno
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from karolos.errors import MachineError, UsageError
from karolos.system import _share_in
from karolos.system.files import FileLock, append_lines, below, read_lines, write_whole, writing

FULL = OSError(errno.ENOSPC, "No space left on device")


def full_disk(*_: object) -> None:
    raise FULL


def test_whole_file_is_replaced_and_kept_if_the_disk_is_full_and_nothing_else_is_left(tmp_path, monkeypatch):
    path = tmp_path / "state.json"
    for text in ("old", "new"):
        write_whole(path, text)
    assert path.read_text() == "new"
    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(MachineError, match=r"state\.json: the disk is full; free some space"):
        write_whole(path, "newer")
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_a_limit_of_file_sizes_is_not_told_as_a_full_disk(tmp_path):
    with pytest.raises(MachineError, match=r"than this shell or disk allows; raise .*`ulimit -f`"), writing(tmp_path):
        raise OSError(errno.EFBIG, "File too large")


def test_full_disk_leaves_no_part_of_a_line(tmp_path, monkeypatch):
    path = tmp_path / "tests.jsonl"
    append_lines(path, [{"steps": 1}])
    write = os.write

    def write_a_little(descriptor: int, data: bytes) -> int:
        if len(data) < 10:
            raise FULL
        return write(descriptor, data[:3])

    monkeypatch.setattr(os, "write", write_a_little)
    with pytest.raises(MachineError, match="disk is full"):
        append_lines(path, [{"steps": 2, "text": "long enough to be torn"}])
    monkeypatch.undo()
    append_lines(path, [{"steps": 3}])
    assert read_lines(path) == (({"steps": 1}, {"steps": 3}), ())


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_system_that_reports_a_full_disk_is_understood(tmp_path):
    (tmp_path / "events.jsonl").symlink_to("/dev/full")
    with pytest.raises(MachineError, match=r"events\.jsonl: the disk is full"):
        append_lines(tmp_path / "events.jsonl", [{"event": "started"}])


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (PermissionError(errno.EACCES, "Permission denied"), "cannot be written; change its permissions"),
        (OSError(errno.EROFS, "Read-only file system"), "cannot be written; change its permissions"),
        (NotADirectoryError(errno.ENOTDIR, "Not a directory"), "a file is in the way of a folder"),
        (OSError(errno.EIO, "Input/output error"), r"cannot be written \(Input/output error\)"),
    ],
)
def test_refusals_of_the_system_say_what_to_do(error, text):
    with pytest.raises(MachineError, match=text), writing(Path("runs")):
        raise error


rows = st.lists(
    st.dictionaries(st.text(max_size=5), st.one_of(st.text(max_size=9), st.integers(-(2**70), 2**70), st.none())),
    min_size=1,
    max_size=5,
)


@settings(max_examples=40)  # each waits for the disk
@given(rows, st.data())
def test_torn_file_gives_the_whole_lines_and_takes_new_ones(rows, data):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "lines.jsonl"
        content = b"".join(json.dumps(row).encode() + b"\n" for row in rows)
        cut = data.draw(st.integers(0, len(content)))
        path.write_bytes(content[:cut])
        whole = content[:cut].count(b"\n")
        found = read_lines(path)
        assert list(found.rows) == rows[:whole]
        assert bool(found.problems) == (cut > 0 and content[cut - 1 : cut] != b"\n")
        append_lines(path, [{"new": 1}])
        assert read_lines(path) == ((*rows[:whole], {"new": 1}), ())


def test_line_that_is_no_object_is_named_and_the_rest_is_read(tmp_path):
    path = tmp_path / "lines.jsonl"
    path.write_bytes(b'{"a":1}\n\xff\xfe\n[1]\n{"a":2}\n{"a"')
    found = read_lines(path)
    assert found.rows == ({"a": 1}, {"a": 2})
    assert [problem.split(":")[1] for problem in found.problems] == ["2", "3", "5"]
    assert "torn" in found.problems[-1]
    assert read_lines(tmp_path / "none") == ((), ())


def test_numbers_that_json_lacks_are_refused(tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        append_lines(tmp_path / "lines.jsonl", [{"loss": float("nan")}])


@pytest.mark.parametrize("name", ["..", "../x", ".", "", "/etc/passwd", "a/../../x", "link"])
def test_path_or_link_that_leads_out_is_refused(tmp_path, name):
    root = tmp_path / "root"
    root.mkdir()
    (root / "link").symlink_to(tmp_path)
    with pytest.raises(UsageError, match="leads outside of"):
        below(root, name)
    assert below(root, "plain") == root / "plain"


def test_lock_excludes_others_until_released(tmp_path):
    ours, theirs = FileLock(tmp_path / "lock"), FileLock(tmp_path / "lock")
    assert not ours.is_locked()
    assert list(tmp_path.iterdir()) == [], "looking leaves no trace"
    assert ours.acquire()
    assert ours.acquire()  # a second time changes nothing
    assert theirs.is_locked()
    assert not theirs.acquire(0.05)
    ours.release()
    ours.release()
    assert not theirs.is_locked()
    assert theirs.acquire()
    theirs.release()


def test_lock_dies_with_its_process(tmp_path):
    script = (
        "import sys, pathlib; from karolos.system.files import FileLock\n"
        "lock = FileLock(pathlib.Path(sys.argv[1])); assert lock.acquire(); print('held', flush=True); sys.stdin.read()"
    )
    command = [sys.executable, "-c", script, str(tmp_path / "lock")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        assert FileLock(tmp_path / "lock").is_locked()
        process.kill()
    assert not FileLock(tmp_path / "lock").is_locked()


def test_a_network_share_is_told_from_a_disk_by_the_innermost_mount(tmp_path):
    mounts = tmp_path / "mounts"
    mounts.write_text(f"disk / ext4 rw 0 0\nserver:/home {tmp_path} nfs4 rw 0 0\ndisk {tmp_path}/local ext4 rw 0 0\n")
    assert _share_in(tmp_path / "runs", mounts) == "nfs4"
    assert _share_in(tmp_path / "local" / "runs", mounts) is None
    assert _share_in(Path("/"), mounts) is None
    assert _share_in(tmp_path, tmp_path / "missing") is None
