import errno
import gzip
import io
import json
import os
import random
import shutil
import subprocess
import sys
import tarfile
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from support.run_samples import new_run, result

from karolos import system
from karolos.errors import MachineError, RunError, UsageError
from karolos.records import RunFolder, labels
from karolos.records.archive import export_runs, import_runs

DESCRIPTION = json.dumps(
    {"format": 1, "id": "a-s0-1", "name": "a", "seed": 0, "experiment": "x", "created": "2026-01-01"}
).encode()


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


def pack(path: Path, members: list[tuple[str | tarfile.TarInfo, bytes]], sums: list[str] | None = None) -> Path:
    """An archive with these members, whatever they are, and the list of them, or these lists."""
    if sums is None:
        sums = ["".join(f"{sha256(data).hexdigest()}  {name}\n" for name, data in members)]
    with tarfile.open(path, "w:gz", format=tarfile.PAX_FORMAT) as tar:
        for name, data in [*members, *(("SHA256SUMS", one.encode()) for one in sums)]:
            entry = name if isinstance(name, tarfile.TarInfo) else tarfile.TarInfo(name)
            entry.size = len(data)
            tar.addfile(entry, io.BytesIO(data))
    return path


def member(**about: Any) -> tarfile.TarInfo:
    """A member run.json that is not a plain file."""
    entry = tarfile.TarInfo("a-s0-1/run.json")
    for name, value in about.items():
        setattr(entry, name, value)
    return entry


def two_runs(run: RunFolder, place: Path) -> Path:
    """An archive of a copy of the run with another id, and then the run."""
    path = shutil.copytree(run.path, place / "reach-s3-z")
    about = json.loads((path / "run.json").read_text())
    (path / "run.json").write_text(json.dumps(about | {"id": path.name}))
    export_runs([RunFolder.open(path), run], place / "two.tar.gz")
    return place / "two.tar.gz"


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


RUN = "a-s0-1/run.json"
GOOD = f"{sha256(DESCRIPTION).hexdigest()}  {RUN}\n"
NAMES = (
    *("../evil", "/etc/evil", "evil", ".trash/x", "a-s0-1", "a-s0-1/", "a-s0-1/evil.py", "a-s0-1/__init__.py"),
    *("a-s0-1/../../evil", "a-s0-1/\x1b[2J", "a-s0-1/x\\..\\..\\evil", "a-s0-1/RUN.json", "a-s0-1/run.json\n"),
    *("a-s0-1/checkpoints/best/evil.py", "a-s0-1/checkpoints/../run.json", "a-s0-1/tensorboard/x/run.json"),
)
KINDS = (tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.FIFOTYPE, tarfile.CHRTYPE, tarfile.DIRTYPE)
LISTS = ([], [GOOD.replace("run", "state")], [GOOD + GOOD.replace("run", "state")], [""], [GOOD, GOOD])


@pytest.mark.parametrize(
    ("members", "lists", "told"),
    [
        *(([(RUN, DESCRIPTION), (name, b"evil")], None, "is not a file of a run") for name in NAMES),
        *(([(member(type=kind, linkname="/etc/passwd"), b"")], None, "is not a plain file") for kind in KINDS),
        *(([(RUN, DESCRIPTION)], one, "is missing|is not as SHA256SUMS says|after its last member") for one in LISTS),
        ([("a-s0-1/code.diff", bytes(3_000_000))], None, "it unpacks to more than 2,000,000 bytes"),
        ([(member(pax_headers={"comment": "x" * 3_000_000}), b"")], None, "a header is too large"),
        ([("a-s0-1/code.diff", b"")], None, "a-s0-1: this is not a run folder"),
        ([(RUN, b"{")], None, "a-s0-1: run.json is damaged"),
        ([("b-s0-1/run.json", DESCRIPTION)], None, "says that it is the run a-s0-1"),
        ([(RUN, DESCRIPTION.replace(b'"format": 1', b'"format": 99'))], None, "a newer karolos made"),
        ([], None, "it contains no run"),
    ],
)
def test_an_archive_with_anything_but_the_listed_files_of_runs_is_refused_and_leaves_nothing(
    tmp_path, members, lists, told
):
    source, runs = pack(tmp_path / "x.tar.gz", members, lists), tmp_path / "in" / "runs"
    with pytest.raises(UsageError, match=told):
        import_runs(source, runs, most_bytes=2_000_000)
    assert sorted(tmp_path.rglob("*")) == [tmp_path / "in", runs, source]


def test_what_follows_the_stream_is_refused(run, tmp_path):
    export_runs([run], tmp_path / "x.tar.gz")
    whole = (tmp_path / "x.tar.gz").read_bytes()
    for more in (b"x", gzip.compress(b"x" * 600), whole, gzip.compress(bytes(100_000))):
        (tmp_path / "y.tar.gz").write_bytes(whole + more)
        with pytest.raises(UsageError, match=r"data after its last member|cannot be read"):
            import_runs(tmp_path / "y.tar.gz", tmp_path / "other")
        assert list((tmp_path / "other").iterdir()) == []


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
    before = contents(tmp_path / "runs")
    with pytest.raises(UsageError, match=f"the run {run.id} exists already"):
        import_runs(two_runs(run, tmp_path), tmp_path / "runs")
    assert contents(tmp_path / "runs") == before


def test_torn_lines_come_in_and_are_told(run, tmp_path):
    with (run.path / "tests.jsonl").open("a") as file:
        file.write('{"steps":')
    export_runs([run], tmp_path / "x.tar.gz")
    (came,) = import_runs(tmp_path / "x.tar.gz", tmp_path / "other")
    assert came.problems == ("tests.jsonl:2: the last line is torn; left out",)
    assert len(came.tests) == 1


def test_an_error_between_two_runs_takes_back_the_first(run, tmp_path, monkeypatch):
    rename, into = system.replace, tmp_path / "other"

    def fail(source: Path, target: Path) -> None:
        if target == into / run.id:
            raise OSError(errno.ENOSPC, "full")
        rename(source, target)

    monkeypatch.setattr(system, "replace", fail)
    with pytest.raises(MachineError, match="disk is full"):
        import_runs(two_runs(run, tmp_path), into)
    assert list(into.iterdir()) == []
