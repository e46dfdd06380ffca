import importlib
import os
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
from support.run_samples import new_run

from karolos.errors import recorded
from karolos.records import provenance
from karolos.specification import spec_from_dict
from karolos.system import files
from karolos.system.files import fingerprint


def git(folder: Path, *arguments: str) -> None:
    name = ["-c", "user.name=a", "-c", "user.email=a@b"]
    subprocess.run(["git", *name, *arguments], cwd=folder, check=True, capture_output=True)


@pytest.fixture
def work_tree(tmp_path: Path) -> Path:
    git(tmp_path, "init")
    (tmp_path / "robot.py").write_text("speed = 1\n")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-m", "first")
    git(tmp_path, "remote", "add", "origin", "https://me:secret@example.org/x.git")
    return tmp_path


def test_a_module_that_was_edited_after_its_import_is_named_until_it_is_reloaded(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "edited_here.py").write_text("REWARD = 1\n")
    module = importlib.import_module("edited_here")

    def found() -> list[str]:
        return provenance.edited_since_import(provenance.sources(["edited_here", "nowhere"]))

    assert found() == found() == []
    (tmp_path / "edited_here.py").write_text("REWARD = 2.5\n")
    assert found() == found() == ["edited_here"]
    importlib.reload(module)
    assert found() == []
    monkeypatch.delitem(sys.modules, "edited_here")


def test_clean_work_tree_has_a_commit_and_no_diff(work_tree):
    commit, diff = provenance.code(work_tree) or ({}, "")
    assert len(commit["commit"]) == 40
    assert (commit["dirty"], diff, commit["untracked"]) == (False, "", [])


def test_a_run_keeps_changes_as_a_diff_and_the_names_of_new_files(work_tree, tmp_path_factory):
    (work_tree / "robot.py").write_text("speed = 2\nurl = 'https://me:secret@example.org'\n")
    (work_tree / "new file.py").write_text("")
    for name in (".env", "deploy.PEM", "home/.ssh/config", "my_credentials.yaml"):
        (work_tree / name).parent.mkdir(parents=True, exist_ok=True)
        (work_tree / name).write_text("1")
        git(work_tree, "add", name)
    run = new_run(tmp_path_factory.mktemp("runs"), source=work_tree)
    commit, diff = run.description()["git"], (run.path / "code.diff").read_text()
    assert commit["dirty"]
    assert "+speed = 2" in diff
    assert "secret" not in diff
    assert diff.count("diff --git") == 1, "files of secrets are left out"
    assert commit["untracked"] == ["new file.py"]


def test_long_diff_is_cut_off(work_tree, monkeypatch):
    monkeypatch.setattr(provenance, "DIFF_BYTES", 200)
    (work_tree / "robot.py").write_text("x" * 10_000)
    code = provenance.code(work_tree)
    assert code is not None
    assert len(code[1]) == 200


def test_programs_that_a_configuration_names_are_not_run(work_tree):
    trap = work_tree / "trap.sh"
    trap.write_text(f"#!/bin/sh\ntouch {work_tree}/sprung\n")
    trap.chmod(0o755)
    for key in ("diff.external", "core.fsmonitor", "core.pager"):
        git(work_tree, "config", key, str(trap))
    (work_tree / "robot.py").write_text("speed = 3\n")
    code = provenance.code(work_tree)
    assert code is not None
    assert "+speed = 3" in code[1]
    assert not (work_tree / "sprung").exists()


def test_folder_or_machine_without_git_has_no_code(work_tree, tmp_path_factory, monkeypatch):
    outside = tmp_path_factory.mktemp("outside")
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(outside.parent))
    assert provenance.code(outside) is None
    monkeypatch.setenv("PATH", "")
    assert provenance.code(work_tree) is None


FILES = {
    "arm.urdf": '<robot><mesh filename="package://arm/meshes/a.stl"/></robot>',
    "door.xml": "<mujoco><compiler meshdir='meshes'/><mesh file='b.stl'/></mujoco>",
    "mine.py": "import json, helper\nPART = 'meshes/c.stl'\ndef x():\n    from beside.deep import y\n",
    "helper.py": "x = 1\nREAD = Path(__file__).parent / 'meshes' / 'd.npy'\n",
    "beside/deep.py": "open(f'{HERE}/e.yaml')\n",
    "beside/e.yaml": "part: f.csv\n",
    "beside/f.csv": "1",
    "meshes/d.npy": "d",
    "meshes/a.stl": "a",
    "meshes/b.stl": "b",
    "meshes/c.stl": "c",
}


@pytest.mark.parametrize(
    ("top", "reads"),
    [
        ("arm.urdf", "arm.urdf meshes/a.stl"),
        ("door.xml", "door.xml meshes/b.stl"),
        ("mine.py", "mine.py helper.py meshes/c.stl meshes/d.npy beside/deep.py beside/e.yaml beside/f.csv"),
        ("meshes", "meshes/a.stl meshes/b.stl meshes/c.stl meshes/d.npy"),
    ],
)
def test_a_fingerprint_changes_with_each_file_that_is_read_and_with_no_other(tmp_path, top, reads):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "beside").mkdir()
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    before = fingerprint(tmp_path / top)
    for name, text in FILES.items():
        (tmp_path / name).write_text(text + " ")
        assert (fingerprint(tmp_path / top) != before) == (name in reads.split()), name
        (tmp_path / name).write_text(text)
    assert fingerprint(tmp_path / top) == before
    assert fingerprint(tmp_path / "missing") is None


def test_large_files_and_folders_and_what_is_written_keep_a_spec_fast(tmp_path, monkeypatch):
    with (tmp_path / "large.npy").open("wb") as file:
        file.truncate(1 << 36)  # without blocks on the disk
    before = fingerprint(tmp_path / "large.npy")
    with (tmp_path / "large.npy").open("r+b") as file:
        file.write(b"edited")
    assert fingerprint(tmp_path / "large.npy") not in (before, None)
    unread: list[str] = []
    monkeypatch.setattr(files, "MOST_FILES", 3)
    for name in "abcde":
        (tmp_path / name).write_text(name)
    assert fingerprint(tmp_path, unread) is None
    assert unread == ["more than 3 files or 4,294,967,296 bytes: its files are ignored"]
    named = {"data": f"{tmp_path}/a", "log_dir": f"{tmp_path}/a", "out": f"{tmp_path}/b", "root": str(tmp_path)}
    environment = {"name": "gymnasium", "id": "Pendulum-v1", "kwargs": named}
    spec = spec_from_dict({"environment": environment, "agent": "sac"})
    assert list(spec.files()) == ["environment.kwargs.data"]


def test_disorder_in_a_package_ends_nothing_and_is_named(tmp_path, monkeypatch):
    package = tmp_path / "untidy_package"
    (package / "old.py").mkdir(parents=True)
    for link, target in ((".#m.py", "me@host.1:2"), ("gone.stl", "nowhere"), ("loop", ".")):
        (package / link).symlink_to(target)
    os.mkfifo(package / "pipe.py")
    monkeypatch.syspath_prepend(tmp_path)
    unread: list[str] = []
    assert set(provenance.sources(["untidy_package", "nowhere", "__main__"], unread)) >= {"karolos", "untidy_package"}
    assert [line.split(": ")[:2] for line in unread] == [["untidy_package", name] for name in ("gone.stl", "pipe.py")]


def test_versions_name_python_and_every_dependency():
    versions = provenance.versions()
    assert versions["python"] == sys.version.split()[0]
    assert versions["torch"] == metadata.version("torch")
    assert versions["karolos"] == metadata.version("karolos")
    assert "pytest" not in versions  # an extra


def test_command_line_tells_no_path_and_no_password(monkeypatch):
    given = ["--database=postgresql://me:pass@host/db?password=x", "agent.api_key=x", "--token", "x", "/home/me/s.yaml"]
    monkeypatch.setattr(sys, "argv", ["/home/me/bin/karolos", "run", *given])
    told = ["--database=postgresql://***@host/db?password=***", "agent.api_key=***", "--token", "***", ".../s.yaml"]
    assert provenance.command_line() == ["karolos", "run", *told]


ORDINARY = (
    "token: str | None = None; passes=2; token = find(x); token: Token | None = None; api_key=api_key; token == x",
    "max_tokens: 100, pass: 2, tokens: [1, 2], token_dim=4, key_frames: a, pass_rate: b, author: c, keyboard=d",
    "low_pass: butter, pad_token: <pad>, mask_token='[MASK]', auth: none, api_key: $MY_KEY",
    "postgresql://me@host/db, ssh://git@host/x, http://localhost:8080/models/name@champion, a://b?x=y@z",
    "sk-learn-based-policy and hf_model_for_something",
)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("postgresql://me:p@ss@host/db", "postgresql://***@host/db"),
        ("https://host/path?a=b@c", "https://host/path?a=b@c"),
        ("postgresql://me:p/ss@host/db", "postgresql://***@host/db"),
        ("https://token@host/x.git and https://host:80/x", "https://***@host/x.git and https://host:80/x"),
        ("postgresql://host/db?user=a&password=b&ssl=1", "postgresql://host/db?user=a&password=***&ssl=1"),
        ("host=x password=y", "host=x password=***"),
        ('"apiKey": "x y"', '"apiKey": ***'),
        ("Authorization: Bearer x", "Authorization: Bearer ***"),
        ("x = 'ghp_0123456789abcdef'", "x = '***'"),
        ("-----BEGIN PRIVATE KEY-----\nx\n", "***"),
        ("login(password=b'x\\'y', --api-key x)", "login(password=***, --api-key ***"),
        (
            "os.environ['API_KEY'] = 'x'; authorization: token x",
            "os.environ['API_KEY'] = ***; authorization: token ***",
        ),
        ("https://h/?sig=x&se=2", "https://h/?sig=***&se=2"),
        ("TOKEN=x | tee log; pwd=1; password = str-ong", "TOKEN=*** | tee log; pwd=***; password = ***"),
        *((text, text) for text in ORDINARY),
    ],
)
def test_redaction_hides_secrets_only(text, expected):
    assert recorded({"what": [text], "secret": text}) == {"what": [expected], "secret": "***"}
