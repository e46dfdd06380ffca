"""Help and commands that only ask the index start fast: what they do not need is not imported."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from support.run_commands import add_run

HEAVY = (
    "alembic",
    "gymnasium",
    "imageio",
    "matplotlib",
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
    code = CALL.format(heavy=[*HEAVY, *more])
    runs = ["--runs", str(tmp_path)] if command.partition(" ")[0] in ("runs", "sweeps") else []
    ended = subprocess.run(
        [sys.executable, "-c", code, "-", *command.split(), *runs],
        capture_output=True,
        text=True,
        check=True,
    )
    assert ended.stderr.splitlines()[-1] == "imported:", ended.stderr
