"""Karolos on Windows and macOS, imitated on Linux: what these systems lack is hidden from its modules.

`tests/support/elsewhere/sitecustomize.py` says what is imitated and what is not.
"""

import ast
import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import chdir
from functools import cache
from pathlib import Path

import pytest
from karolos_cli.main import app
from support.commands import call

ROOT = Path(__file__).parents[1]
ELSEWHERE = ROOT / "tests" / "support" / "elsewhere"
OWN = sorted(path for folder in ("karolos", "cli") for path in (ROOT / folder).rglob("*.py"))


@cache
def hidden() -> tuple[set[str], set[tuple[str, str]]]:
    """Modules, and names of modules, that another system lacks."""
    spec = importlib.util.spec_from_file_location("elsewhere", ELSEWHERE / "sitecustomize.py")
    assert spec is not None
    assert spec.loader is not None
    imitation = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(imitation)
    modules = {name for names in imitation.MODULES.values() for name in names.split()}
    by_module = [pair for names in imitation.NAMES.values() for pair in names.items()]
    return modules, {(module, name) for module, names in by_module for name in names.split()}


def faults(source: str) -> Iterator[str]:
    """What in a module another system lacks, or understands in another way."""
    modules, names = hidden()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (f"{node.lineno}: import {one.name}" for one in node.names if one.name in modules)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            if node.module in modules:
                yield f"{node.lineno}: from {node.module}"
            lacking = [one.name for one in node.names if (str(node.module), one.name) in names]
            yield from (f"{node.lineno}: from {node.module} import {name}" for name in lacking)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name | ast.Attribute):
            if (ast.unparse(node.value), node.attr) in names:
                yield f"{node.lineno}: {ast.unparse(node)}"
        elif isinstance(node, ast.Call):
            yield from faults_of_call(node)


def faults_of_call(call: ast.Call) -> Iterator[str]:
    """Files opened without an encoding are found by ruff (PLW1514)."""
    function = ast.unparse(call.func)
    keywords = {one.arg for one in call.keywords}
    if function.startswith("subprocess.") and "text" in keywords and "encoding" not in keywords:
        yield f"{call.lineno}: no encoding in {ast.unparse(call)}"
    if function == "os.kill" and ast.unparse(call.args[1]) == "0":
        yield f"{call.lineno}: {ast.unparse(call)} sends Ctrl-C on Windows"


def test_only_one_module_uses_what_another_system_lacks():
    found = {str(path.relative_to(ROOT)): list(faults(path.read_text("utf-8"))) for path in OWN}
    assert {
        name: problems for name, problems in found.items() if problems and name != "karolos/system/__init__.py"
    } == {}


@pytest.mark.parametrize(
    "line",
    ["import fcntl", "import os; os.kill(pid, 0)", "import os; os.getuid()", "subprocess.run(command, text=True)"],
)
def test_a_fault_is_found(line):
    assert list(faults(line))


RUN = "run karolos:smoke/toy orchestrator.processes=1 training.steps=300 --quiet"
CALL = """
import sys
from pathlib import Path
from karolos_cli import main
first = ""
for words in sys.argv[1:]:
    first = first or next((path.name for path in Path("runs").glob("*-s0-*")), "")
    sys.argv = ["karolos", *words.replace("FIRST", first).split()]
    try:
        main()
    except SystemExit as end:
        assert not end.code, words
"""


def run_here(folder: Path, *commands: str, **environment: str) -> str:
    """Call karolos in a folder, one command after the other; FIRST is the run of seed 0. What it prints."""
    call = [sys.executable, "-X", "warn_default_encoding", "-c", CALL, *commands]
    done = subprocess.run(
        call, cwd=folder, env=os.environ | environment, capture_output=True, encoding="utf-8", check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def there(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same run on Linux."""
    folder = tmp_path_factory.mktemp("linux")
    with chdir(folder):
        assert call(app, *RUN.split()) == (0, "", "")
    (run,) = folder.glob("runs/*-s0-*")
    return run


@pytest.mark.xdist_group(__name__)
@pytest.mark.parametrize(("as_system", "seeds"), [("windows", (0, 1)), ("macos", (0,))])
def test_runs_are_made_stopped_resumed_and_compared(as_system, seeds, there, tmp_path):
    """Two processes of runs with a worker each; the training episodes are those of Linux.

    On macOS processes of runs are started as on Linux: one run in the command's process shows the rest.
    """
    environment = {"KAROLOS_AS": as_system, "PYTHONPATH": os.pathsep.join([str(ELSEWHERE), str(ROOT)])}
    commands = "compare smoke_toy", "runs rm FIRST", "runs restore FIRST", "runs list --json"
    told = run_here(
        tmp_path, f"{RUN} seeds={list(seeds)} --jobs {len(seeds)}".replace(", ", ","), *commands, **environment
    )
    (elsewhere,) = (tmp_path / "runs").glob("*-s0-*")
    assert (elsewhere / "episodes.jsonl").read_bytes() == (there / "episodes.jsonl").read_bytes()
    assert "smoke_toy" in told
    rows = [json.loads(line) for line in told.splitlines() if line.startswith('{"run"')]
    assert [row["state"] for row in rows] == ["finished"] * len(seeds)
