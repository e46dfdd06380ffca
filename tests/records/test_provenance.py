from __future__ import annotations

import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

from karolos.records import provenance


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


def test_clean_work_tree_has_a_commit_and_no_diff(work_tree: Path) -> None:
    code = provenance.code(work_tree)
    assert code is not None
    assert len(code.commit) == 40
    assert (code.dirty, code.diff, code.untracked) == (False, "", ())


def test_changes_are_kept_as_a_diff_and_new_files_are_named(work_tree: Path) -> None:
    (work_tree / "robot.py").write_text("speed = 2\nurl = 'https://me:secret@example.org'\n")
    (work_tree / "new file.py").write_text("")
    code = provenance.code(work_tree)
    assert code is not None
    assert code.dirty
    assert "+speed = 2" in code.diff
    assert "secret" not in code.diff
    assert code.untracked == ("new file.py",)


def test_long_diff_is_cut_off(work_tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provenance, "DIFF_BYTES", 200)
    (work_tree / "robot.py").write_text("x" * 10_000)
    code = provenance.code(work_tree)
    assert code is not None
    assert len(code.diff) == 200


def test_programs_that_a_configuration_names_are_not_run(work_tree: Path) -> None:
    trap = work_tree / "trap.sh"
    trap.write_text(f"#!/bin/sh\ntouch {work_tree}/sprung\n")
    trap.chmod(0o755)
    for key in ("diff.external", "core.fsmonitor", "core.pager"):
        git(work_tree, "config", key, str(trap))
    (work_tree / "robot.py").write_text("speed = 3\n")
    code = provenance.code(work_tree)
    assert code is not None
    assert "+speed = 3" in code.diff
    assert not (work_tree / "sprung").exists()


def test_folder_without_git_has_no_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert provenance.code(tmp_path) is None


def test_machine_without_git_has_no_code(work_tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    assert provenance.code(work_tree) is None


def test_versions_name_python_and_every_dependency() -> None:
    versions = provenance.versions()
    assert versions["python"] == sys.version.split()[0]
    assert versions["torch"] == metadata.version("torch")
    assert versions["karolos"] == metadata.version("karolos")
    assert "pytest" not in versions  # an extra


def test_command_line_tells_no_path_and_no_password(monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = ["/home/me/bin/karolos", "run", "s.yaml", "--database=postgresql://me:pass@host/db"]
    monkeypatch.setattr(sys, "argv", arguments)
    assert provenance.command_line() == ["karolos", "run", "s.yaml", "--database=postgresql://***@host/db"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("postgresql://me:p@ss@host/db", "postgresql://***@host/db"),
        ("https://host/path?a=b@c", "https://host/path?a=b@c"),
        ("postgresql://me:p/ss@host/db", "postgresql://***@host/db"),
        ("https://token@host/x.git and https://host:80/x", "https://***@host/x.git and https://host:80/x"),
        ("nothing", "nothing"),
    ],
)
def test_redaction_hides_credentials_only(text: str, expected: str) -> None:
    assert provenance.redact(text) == expected
