"""Starter packages: a small, complete and tested plugin of each kind, to be changed step by step."""

from __future__ import annotations

import keyword
import re
from importlib.resources import files
from pathlib import Path
from string import Template

from ..errors import UsageError
from ..registry import alternatives

KINDS = ("robot", "task", "agent", "buffer", "environment", "distribution")
"""Kinds with a starter package."""


def write_starter(kind: str, name: str, out: Path) -> list[Path]:
    """Write the package `karolos-<name>` into `out`; returns its files, sorted.

    Args:
        kind: one of KINDS.
        name: of the plugin in specs: lower-case letters, digits and underscores.
        out: the package's folder; created if it is missing.

    Raises:
        UsageError: the kind or the name is invalid, or the folder is not empty or cannot be written.
    """
    if kind not in KINDS:
        raise UsageError(f"there is no starter for {kind!r}", hint=alternatives(kind, KINDS))
    if not re.fullmatch(r"[a-z](_?[a-z0-9])*", name) or keyword.iskeyword(name) or len(name) > 60:
        raise UsageError(
            f"{name!r} cannot be the name of a plugin",
            hint="lower-case letters, digits and single underscores, beginning with a letter, not a Python keyword",
        )
    texts = _rendered(kind, name)
    try:
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise UsageError("already exists", where=str(out), hint="name another folder with --out DIR")
        for path, text in texts.items():
            (out / path).parent.mkdir(parents=True, exist_ok=True)
            (out / path).write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot be written: {error.strerror}", where=str(out)) from error
    return [out / path for path in sorted(texts)]


def _rendered(kind: str, name: str) -> dict[str, str]:
    """The package's files: path below its folder -> text."""
    values = {
        "kind": kind,
        "name": name,
        "dashed": name.replace("_", "-"),
        "class_name": "".join(word.capitalize() for word in name.split("_")),
    }
    package = f"src/karolos_{name}"
    templates = {
        "pyproject.toml": "pyproject.toml",
        "README.md": "README.md",
        f"{package}/__init__.py": "__init__.py",
        f"{package}/{name}.py": f"{kind}.py",
        f"tests/test_{name}.py": f"test_{kind}.py",
    }
    if kind == "robot":
        templates[f"{package}/{name}.urdf"] = "robot.urdf"
    folder = files("karolos.plugins") / "starters"
    return {
        path: Template((folder / f"{template}.txt").read_text(encoding="utf-8")).substitute(values)
        for path, template in templates.items()
    }
