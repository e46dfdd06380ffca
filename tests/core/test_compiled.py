"""Compiled functions lie where the platform keeps caches, are compiled once, and never mistaken for others."""

import os
import sys
from pathlib import Path
from subprocess import PIPE, Popen

import pytest

from karolos import system
from karolos.core import compiled
from karolos.system import files

CALLED = "from karolos.core.compiled import compiled\n@compiled\ndef one(): return {}\n"
SHARED = "def half(): return {}\n"
CALLER = """
from functools import partial
import shared
from called import one
from karolos.core.compiled import compiled, share
share(shared.half)
@partial(compiled, told=True)
def two(): return one(), 1 / (one() - one()), shared.half()
print(two())
"""


def start(folder: Path, **variables: str) -> Popen[str]:
    environment = {name: value for name, value in os.environ.items() if name != compiled.VARIABLE} | variables
    return Popen([sys.executable, "caller.py"], cwd=folder, env=environment, text=True, stdout=PIPE, stderr=PIPE)


def test_of_several_processes_one_compiles_and_no_other_code_or_damaged_file_is_used(tmp_path):
    kept = tmp_path / "kept"
    (tmp_path / "caller.py").write_text(CALLER)

    def outputs(value: float, processes: int, half: float = 0.5) -> tuple[list[str], str]:
        for name, text in (("called.py", CALLED.format(value)), ("shared.py", SHARED.format(half))):
            (tmp_path / name).write_text(text)
            os.utime(tmp_path / name, (0, 100 * value + half * 8))  # Python looks at the time of a source, too
        started = [start(tmp_path, KAROLOS_CACHE=str(kept)) for _ in range(processes)]
        said = [process.communicate(timeout=100) for process in started]
        return [out for out, _ in said], "".join(err for _, err in said)

    out, err = outputs(1.0, 2)
    assert out == ["(1.0, inf, 0.5)\n"] * 2
    assert err.count(f"compiling the physics (kept in {kept}) ...\ncompiled in") == 1
    files = set(tmp_path.rglob("*.nb?"))
    assert files == set(kept.rglob("*.nb?")) != set()
    for file in files:
        file.write_bytes(b"")
    assert "compiling" in outputs(1.0, 1)[1]
    assert outputs(1.0, 1) == (["(1.0, inf, 0.5)\n"], "")
    for value, half in ((2.0, 0.5), (2.0, 0.25)):
        out, err = outputs(value, 1, half)
        assert (out, "compiling" in err) == ([f"({value}, inf, {half})\n"], True)


def test_where_nothing_can_be_kept_one_line_says_so_and_processes_share_a_temporary_folder(tmp_path):
    (tmp_path / "called.py").write_text(CALLED.format(1.0))
    (tmp_path / "shared.py").write_text(SHARED.format(0.5))
    again = "import subprocess, sys\nif len(sys.argv) < 2: subprocess.run([sys.executable, *sys.argv, 'again'])\n"
    (tmp_path / "caller.py").write_text(CALLER + again)
    (tmp_path / "temporary").mkdir()
    out, err = start(tmp_path, XDG_CACHE_HOME="/dev/null", TMPDIR=str(tmp_path / "temporary")).communicate(timeout=100)
    assert out.count("inf") == 2
    assert err.count("/dev/null/karolos cannot be written: each command compiles again; set KAROLOS_CACHE") == 1
    assert err.count("compiling") == 1
    assert list((tmp_path / "temporary").glob("karolos-*")) == []


def test_a_folder_in_the_cache_that_cannot_be_written_or_a_full_disk_is_told(tmp_path, monkeypatch, capsys):
    ensure, refused = compiled._Locator.ensure_cache_path, [tmp_path]

    def write(locator):
        if any(folder in Path(locator.get_cache_path()).parents for folder in refused):
            raise OSError(28, "no space")
        ensure(locator)

    monkeypatch.setattr(compiled._Locator, "ensure_cache_path", write)
    monkeypatch.setenv("KAROLOS_CACHE", str(tmp_path))
    compiled.cache_folder.cache_clear()
    made = compiled.compiled(lambda: 1, told=True)
    refused.append(compiled.cache_folder())
    assert made() == 1
    monkeypatch.undo()
    compiled.cache_folder.cache_clear()
    compiled._use_temporary_folder.cache_clear()
    first, *_, last = capsys.readouterr().err.splitlines()
    assert f"{tmp_path} cannot be written: each command compiles again" in first
    assert "cannot be written: no space" in last


def test_who_waits_for_a_process_that_compiles_says_so_and_then_compiles(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("KAROLOS_CACHE", str(tmp_path))
    monkeypatch.setattr(compiled, "SILENT_SECONDS", 0)
    monkeypatch.setattr(compiled, "WAIT_SECONDS", 0)
    compiled.cache_folder.cache_clear()
    with files.locked(tmp_path / "lock"):
        assert compiled.compiled(lambda: 1)() == 1
    compiled.cache_folder.cache_clear()
    assert f"another process is compiling, or was stopped while it did ({tmp_path / 'lock'})" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("platform", "variables", "folder"),
    [
        ("linux", {}, "home/.cache/karolos"),
        ("linux", {"XDG_CACHE_HOME": "/caches"}, "/caches/karolos"),
        ("linux", {"XDG_CACHE_HOME": "relative"}, "home/.cache/karolos"),
        ("darwin", {}, "home/Library/Caches/karolos"),
        ("win32", {"LOCALAPPDATA": "/local"}, "/local/karolos"),
        ("win32", {}, "home/AppData/Local/karolos"),
        ("linux", {"KAROLOS_CACHE": "mine"}, "mine"),
    ],
)
def test_caches_lie_where_the_platform_keeps_them(tmp_path, monkeypatch, platform, variables, folder):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(system, "MACOS", platform == "darwin")
    monkeypatch.setattr(system, "WINDOWS", platform == "win32")
    monkeypatch.setattr(Path, "mkdir", lambda *_, **__: None)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for name in ("XDG_CACHE_HOME", "LOCALAPPDATA", "KAROLOS_CACHE"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert compiled.cache_folder.__wrapped__() == tmp_path / folder
