"""What a command or a module does not need is not imported, so that it starts fast and is small in a worker."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from support.run_samples import add_run

HEAVY = (
    "alembic",
    "gymnasium",
    "imageio",
    "matplotlib",
    "mujoco",
    "multiprocessing.connection",
    "numpy",
    "onnx",
    "optuna",
    "pybullet",
    "ray",
    "scipy",
    "sqlalchemy.orm",
    "sqlalchemy.dialects.postgresql",
    "tensorboard",
    "torch",
    "yaml",
)
CALL = """
import sys
from karolos_cli import main
sys.argv = ["karolos", *sys.argv[2:]]
heavy = {heavy!r}
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
print("imported:", *[name for name in heavy if name in sys.modules], file=sys.stderr)
"""


@pytest.mark.parametrize(
    ("command", "more"),
    [
        ("--help", []),
        ("run --help", []),
        ("plugins list", []),
        ("runs list", []),
        ("runs list agent=sac --json", ["rich"]),
        ("runs list --csv", ["rich"]),
        ("sweeps list", ["rich"]),
    ],
)
def test_help_and_the_index_import_only_what_they_need(tmp_path: Path, command: str, more: list[str]) -> None:
    add_run(tmp_path, 0)
    runs = ["--runs", str(tmp_path)] if command.startswith(("runs", "sweeps")) else []
    assert imported([*HEAVY, *more], *command.split(), *runs) == "imported:"


@pytest.mark.parametrize("command", ["compare reach", "runs show @last"])
def test_comparing_and_showing_import_nothing_that_trains_or_draws(tmp_path: Path, command: str) -> None:
    add_run(tmp_path, 0)
    needed = ("numpy", "sqlalchemy.orm", "yaml")
    heavy = [name for name in HEAVY if name not in needed]
    assert imported(heavy, *command.split(), "--runs", str(tmp_path)) == "imported:"


def imported(heavy: list[str], *words: str) -> str:
    """The last line that the command's process prints: those of the heavy packages that it has imported."""
    code = CALL.format(heavy=heavy)
    ended = subprocess.run([sys.executable, "-c", code, "-", *words], capture_output=True, text=True, check=True)
    return ended.stderr.splitlines()[-1]


DESCRIBE = """
import karolos.specification
from karolos.specification.parts import Part
for kind, name in [("environments", "toy"), ("robots", "panda"), ("tasks", "reach")]:
    Part.of(kind, name, {})
"""


@pytest.mark.parametrize(
    ("code", "heavy"),
    [
        ("import karolos", "torch numpy sqlalchemy pydantic gymnasium importlib.metadata"),
        ("import karolos.export", "torch pydantic pybullet mujoco onnx"),
        ("import karolos.records.checkpoint", "torch"),
        ("import karolos.orchestrator.local", "torch pybullet mujoco sqlalchemy"),
        (DESCRIBE, "torch pybullet mujoco sqlalchemy typer"),
    ],
)
def test_a_module_imports_only_what_it_needs(code: str, heavy: str) -> None:
    script = f"{code}\nimport sys\nprint([name for name in {heavy.split()} if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout == "[]\n"
