"""Starter packages, written and made importable as if they were installed."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

STARTERS = {
    "robot": "desk_arm",
    "gripper": "my_hand",
    "task": "my_task",
    "agent": "my_agent",
    "buffer": "my_buffer",
    "environment": "my_environment",
    "distribution": "my_distribution",
    "driver": "my_driver",
}
"""Kinds, and what docs/extending.md calls its example of each."""


def install(package: Path) -> Path:
    """Make the package's sources a distribution with metadata; returns the folder that belongs on Python's path.

    What `pip install -e` does, but in milliseconds and without an index.
    """
    project = tomllib.loads((package / "pyproject.toml").read_text())["project"]
    sources = package / "src"
    metadata = sources / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    )
    lines: list[str] = []
    for group, points in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {target}" for name, target in points.items())]
    (metadata / "entry_points.txt").write_text("\n".join(lines) + "\n")
    return sources


def python(*arguments: str, sources: list[Path], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run Python in a process of its own in which these sources are installed."""
    path = os.pathsep.join(map(str, sources))
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
