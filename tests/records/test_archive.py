import errno
import gzip
import io
import json
import os
import random
import subprocess
import sys
import tarfile
from hashlib import sha256
from pathlib import Path

import pytest
from support.run_samples import new_run, result

from karolos import system
from karolos.errors import MachineError, RunError, UsageError
from karolos.records import RunFolder, labels
from karolos.records.archive import export_runs, import_runs

DESCRIPTION = {"format": 1, "id": "a-s0-1", "name": "a", "seed": 0, "experiment": "x", "created": "2026-01-01"}


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    with new_run(tmp_path / "runs", text="task: reach\n", source=tmp_path) as folder:
        folder.add_test(result(10, 3))
        folder.set_state("finished", steps=10)
        (folder.path / "checkpoints" / "best").mkdir(parents=True)
        (folder.path / "checkpoints" / "best" / "agent.pt").write_bytes(random.Random(0).randbytes(5000))
        (folder.path / "checkpoints" / "last").mkdir(parents=True)
        os.link(folder.path / "checkpoints" / "best" / "agent.pt", folder.path / "checkpoints" / "last" / "agent.pt")
    labels.add_tags(folder.path, ["good"])
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files if not path.name.endswith("lock")}


def pack(path: Path, files: dict[str, bytes]) -> Path:
    """An archive with these names, whatever they are, and the list of them."""
    sums = "".join(f"{sha256(data).hexdigest()}  {name}\n" for name, data in files.items())
    with tarfile.open(path, "w:gz") as tar:
        for name, data in {**files, "SHA256SUMS": sums.encode()}.items():
            entry = tarfile.TarInfo(name)
            entry.size = len(data)
            tar.addfile(entry, io.BytesIO(data))
    return path


def test_runs_come_out_as_they_went_in(run, tmp_path):
    exported = export_runs([run], tmp_path / "x.tar.gz")
    assert exported == (len(contents(run.path)), ())
    (came,) = import_runs(tmp_path / "x.tar.gz", tmp_path / "other")
    folder = tmp_path / "other" / run.id
    assert came == RunFolder.open(folder).record()
    assert came.problems == ()
    assert contents(folder) == contents(run.path)
    assert came.tests == run.record().tests
    assert [path.name for path in (tmp_path / "other").iterdir()] == [run.id]


def test_checkpoints_can_be_left_out(run, tmp_path):
    export_runs([run], tmp_path / "x.tar.gz", checkpoints=False)
    (came,) = import_runs(tmp_path / "x.tar.gz", tmp_path / "other")
    assert not (Path(came.summary.folder) / "checkpoints").exists()
    assert came.tests == run.record().tests


def test_an_archive_without_source_tells_no_code_command_path_or_name_and_none_tells_a_secret(run, tmp_path):
    (run.path / "code.diff").write_text("+x\n")
    about = json.loads((run.path / "run.json").read_text())
    git = {"commit": "a", "dirty": True, "untracked": ["love_letter"]}
    about |= {"command": ["run", "/home/me/s.yaml", "--url=x?password=geheim"], "git": git}
    (run.path / "run.json").write_text(json.dumps(about))
    with run:
        run.event("failed", error="token=geheim in /home/me/x.py", traceback="File /home/me/x.py")
    export_runs([run], tmp_path / "x.tar.gz")
    import_runs(tmp_path / "x.tar.gz", tmp_path / "with")
    told = b"".join(contents(tmp_path / "with").values())
    assert [word in told for word in (b"geheim", b"love_letter", b"/home/me", b"+x")] == [False, True, True, True]
    export_runs([run], tmp_path / "y.tar.gz", source=False)
    (came,) = import_runs(tmp_path / "y.tar.gz", tmp_path / "without")
    assert came.problems == ()
    told = b"".join(contents(tmp_path / "without").values())
    assert not [word for word in (b"geheim", b"love_letter", b"/home/me", b"+x") if word in told]


def test_export_refuses_what_is_there_or_running_and_leaves_nothing(run, tmp_path):
    place = tmp_path / "out"
    place.mkdir()
    with pytest.raises(UsageError, match=r"archives end in \.tar\.gz"):
        export_runs([run], place / "x.rar")
    (place / "x.tar.gz").write_text("mine")
    with pytest.raises(UsageError, match="the file exists already"):
        export_runs([run], place / "x.tar.gz")
    assert (place / "x.tar.gz").read_text() == "mine"
    with new_run(tmp_path / "runs", source=tmp_path) as busy, pytest.raises(RunError, match="another process"):
        export_runs([run, RunFolder.open(busy.path)], place / "y.tar.gz")
    assert [path.name for path in place.iterdir()] == ["x.tar.gz"]


KILLED = """
import os, sys
from pathlib import Path
from karolos.records import archive
archive._examine = lambda *_: os.kill(os.getpid(), 9)
archive.import_runs(Path(sys.argv[1]), Path(sys.argv[2]))
"""


def test_the_next_import_removes_what_a_killed_one_unpacked(run, tmp_path):
    source, runs = tmp_path / "x.tar.gz", tmp_path / "other"
    export_runs([run], source)
    done = subprocess.run([sys.executable, "-c", KILLED, source, runs], timeout=60, check=False)
    assert done.returncode == -9
    (left,) = runs.iterdir()
    assert left.name.startswith(".import-")
    import_runs(source, runs)
    assert [path.name for path in runs.iterdir()] == [run.id]


def test_the_next_export_removes_what_a_killed_one_wrote(run, tmp_path):
    with subprocess.Popen([sys.executable, "-c", ""]) as dead:
        pass
    place = tmp_path / "out"
    place.mkdir()
    left, other = (place / f".{name}.{dead.pid}.tmp" for name in ("x.tar.gz", "notes"))
    left.touch()
    other.touch()
    export_runs([run], place / "x.tar.gz")
    assert sorted(path.name for path in place.iterdir()) == sorted([other.name, "x.tar.gz"])


def test_an_archive_holds_the_files_of_runs_and_no_others(run, tmp_path):
    (run.path / "evil.py").write_text("")
    (run.path / "stop").write_text("")
    (run.path / "state.txt").symlink_to("/etc/hostname")
    exported = export_runs([run], tmp_path / "x.tar.gz")
    assert exported.left_out == (f"{run.id}/evil.py", f"{run.id}/state.txt (a link)")
    with tarfile.open(tmp_path / "x.tar.gz") as tar:
        assert not {f"{run.id}/evil.py", f"{run.id}/state.txt", f"{run.id}/stop"} & set(tar.getnames())


@pytest.mark.parametrize(
    "name",
    [
        *("../evil", "/etc/evil", "evil", ".trash/x", "a-s0-1", "a-s0-1/", "a-s0-1/evil.py", "a-s0-1/__init__.py"),
        *("a-s0-1/../../evil", "a-s0-1/\x1b[2J", "a-s0-1/x\\..\\..\\evil", "a-s0-1/RUN.json", "a-s0-1/run.json\n"),
        *("a-s0-1/checkpoints/best/evil.py", "a-s0-1/checkpoints/../run.json", "a-s0-1/tensorboard/x/run.json"),
    ],
)
def test_a_file_that_no_run_has_is_refused(tmp_path, name):
    source = pack(tmp_path / "x.tar.gz", {"a-s0-1/run.json": json.dumps(DESCRIPTION).encode(), name: b"evil"})
    with pytest.raises(UsageError, match="is not a file of a run"):
        import_runs(source, tmp_path / "in" / "runs")
    assert list((tmp_path / "in").rglob("*")) == [tmp_path / "in" / "runs"]
    assert not (tmp_path / "evil").exists()


@pytest.mark.parametrize("kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.FIFOTYPE, tarfile.CHRTYPE, tarfile.DIRTYPE])
def test_link_or_device_is_refused(tmp_path, kind):
    with tarfile.open(tmp_path / "x.tar.gz", "w:gz") as tar:
        entry = tarfile.TarInfo("a-s0-1/run.json")
        entry.type, entry.linkname = kind, "/etc/passwd"
        tar.addfile(entry)
    with pytest.raises(UsageError, match="is not a plain file"):
        import_runs(tmp_path / "x.tar.gz", tmp_path / "runs")
    assert list((tmp_path / "runs").iterdir()) == []


def test_a_list_of_files_that_is_missing_wrong_or_not_the_last_is_refused(tmp_path):
    description = json.dumps(DESCRIPTION).encode()
    good = f"{sha256(description).hexdigest()}  a-s0-1/run.json\n"
    for lists in ([], [good.replace("run", "state")], [good + good.replace("run", "state")], [""], [good, good]):
        with tarfile.open(tmp_path / "x.tar.gz", "w:gz") as tar:
            for name, data in [("a-s0-1/run.json", description), *(("SHA256SUMS", one.encode()) for one in lists)]:
                entry = tarfile.TarInfo(name)
                entry.size = len(data)
                tar.addfile(entry, io.BytesIO(data))
        with pytest.raises(UsageError, match=r"is missing|is not what SHA256SUMS says|data after its last member"):
            import_runs(tmp_path / "x.tar.gz", tmp_path / "runs")
        assert list((tmp_path / "runs").iterdir()) == []


def test_what_follows_the_stream_is_refused(run, tmp_path):
    export_runs([run], tmp_path / "x.tar.gz")
    whole = (tmp_path / "x.tar.gz").read_bytes()
    for more in (b"x", gzip.compress(b"x" * 600), whole, gzip.compress(bytes(100_000))):
        (tmp_path / "y.tar.gz").write_bytes(whole + more)
        with pytest.raises(UsageError, match=r"data after its last member|cannot be read"):
            import_runs(tmp_path / "y.tar.gz", tmp_path / "other")
        assert list((tmp_path / "other").iterdir()) == []


def test_archive_that_unpacks_to_too_much_is_refused(tmp_path):
    bomb = pack(tmp_path / "x.tar.gz", {"a-s0-1/code.diff": bytes(3_000_000)})
    with pytest.raises(UsageError, match="it unpacks to more than 2,000,000 bytes"):
        import_runs(bomb, tmp_path / "runs", most_bytes=2_000_000)
    assert list((tmp_path / "runs").iterdir()) == []


def test_a_header_that_fills_the_memory_is_refused(tmp_path):
    with tarfile.open(tmp_path / "x.tar.gz", "w:gz", format=tarfile.PAX_FORMAT) as tar:
        entry = tarfile.TarInfo("a-s0-1/run.json")
        entry.pax_headers = {"comment": "x" * 3_000_000}
        tar.addfile(entry)
    with pytest.raises(UsageError, match="a header is too large"):
        import_runs(tmp_path / "x.tar.gz", tmp_path / "runs")


def test_damaged_archive_is_told_and_brings_nothing(run, tmp_path):
    source = tmp_path / "x.tar.gz"
    export_runs([run], source)
    whole = source.read_bytes()
    for damaged in (whole[: len(whole) // 2], b"", whole[:100] + b"\xff" * 500 + whole[600:]):
        source.write_bytes(damaged)
        with pytest.raises(UsageError, match=r"the archive cannot be read|SHA256SUMS, is missing"):
            import_runs(source, tmp_path / "other")
        assert list((tmp_path / "other").iterdir()) == []
    source.write_bytes(b"robot: panda")
    with pytest.raises(
        UsageError, match=r"x\.tar\.gz: is not an archive of runs; `karolos runs export` makes archives$"
    ):
        import_runs(source, tmp_path / "other")
    with pytest.raises(UsageError, match="the archive cannot be opened"):
        import_runs(tmp_path / "none.tar.gz", tmp_path / "other")


def test_run_that_is_here_is_refused_and_the_others_do_not_come(run, tmp_path):
    with new_run(tmp_path / "second", source=tmp_path) as other:
        pass
    other.path.rename(tmp_path / "second" / "reach-s3-z")
    file = tmp_path / "second" / "reach-s3-z" / "run.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"id": "reach-s3-z"}))
    export_runs([RunFolder.open(tmp_path / "second" / "reach-s3-z"), run], tmp_path / "x.tar.gz")
    before = contents(tmp_path / "runs")
    with pytest.raises(UsageError, match=f"the run {run.id} exists already"):
        import_runs(tmp_path / "x.tar.gz", tmp_path / "runs")
    assert contents(tmp_path / "runs") == before


def test_torn_lines_come_in_and_are_told(run, tmp_path):
    with (run.path / "tests.jsonl").open("a") as file:
        file.write('{"steps":')
    export_runs([run], tmp_path / "x.tar.gz")
    (came,) = import_runs(tmp_path / "x.tar.gz", tmp_path / "other")
    assert came.problems == ("tests.jsonl:2: the last line is torn; left out",)
    assert len(came.tests) == 1


@pytest.mark.parametrize(
    ("files", "told"),
    [
        ({"a-s0-1/code.diff": b""}, "a-s0-1: this is not a run folder"),
        ({"a-s0-1/run.json": b"{"}, "a-s0-1: run.json is damaged"),
        ({"b-s0-1/run.json": json.dumps(DESCRIPTION).encode()}, "says that it is the run a-s0-1"),
        ({"a-s0-1/run.json": json.dumps(DESCRIPTION | {"format": 99}).encode()}, "a newer karolos made"),
        ({}, "it contains no run"),
    ],
)
def test_folder_that_is_no_run_is_refused(tmp_path, files, told):
    with pytest.raises(UsageError) as caught:
        import_runs(pack(tmp_path / "x.tar.gz", files), tmp_path / "runs")
    assert told in str(caught.value)
    assert list((tmp_path / "runs").iterdir()) == []


def test_an_error_between_two_runs_takes_back_the_first(run, tmp_path, monkeypatch):
    export_runs([run], tmp_path / "x.tar.gz")
    (second,) = import_runs(tmp_path / "x.tar.gz", tmp_path / "second")
    path = Path(second.summary.folder).rename(tmp_path / "second" / "reach-s3-z")
    description = json.loads((path / "run.json").read_text())
    (path / "run.json").write_text(json.dumps({**description, "id": path.name}))
    export_runs([RunFolder.open(path), run], tmp_path / "y.tar.gz")
    rename, into = system.replace, tmp_path / "other"

    def fail(source: Path, target: Path) -> None:
        if target == into / run.id:
            raise OSError(errno.ENOSPC, "full")
        rename(source, target)

    monkeypatch.setattr(system, "replace", fail)
    with pytest.raises(MachineError, match="disk is full"):
        import_runs(tmp_path / "y.tar.gz", into)
    assert list(into.iterdir()) == []
