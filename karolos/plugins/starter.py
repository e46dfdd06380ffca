"""Starter packages: a plugin of each kind that is small, whole and tested, to be changed into what one needs."""

from __future__ import annotations

import keyword
import re
from importlib.resources import files
from pathlib import Path
from string import Template

from ..errors import UsageError
from ..registry import alternatives

KINDS = ("robot", "task", "agent", "buffer", "environment", "distribution")
"""What there is a starter for. An orchestrator is too much to begin from a page."""


def write_starter(kind: str, name: str, out: Path) -> list[Path]:
    """Write the package `karolos-<name>` into `out`; returns its files, sorted.

    Args:
        kind: one of KINDS.
        name: of the plugin, as a spec will call it: lower-case letters, digits and underscores.
        out: the package's folder; made if it is not there.

    Raises:
        UsageError: no such kind, a name that cannot be one, or a folder that holds something or cannot be written.
    """
    if kind not in KINDS:
        raise UsageError(f"there is no starter for {kind!r}", hint=alternatives(kind, KINDS))
    if not re.fullmatch(r"[a-z](_?[a-z0-9])*", name) or keyword.iskeyword(name) or len(name) > 60:
        raise UsageError(
            f"{name!r} cannot be the name of a plugin",
            hint="lower-case letters, digits and single underscores, beginning with a letter, no word of Python's own",
        )
    texts = _rendered(kind, name)
    try:
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise UsageError("is there already", where=str(out), hint="name another folder with --out DIR")
        for path, text in texts.items():
            (out / path).parent.mkdir(parents=True, exist_ok=True)
            (out / path).write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot be written: {error.strerror}", where=str(out)) from error
    return [out / path for path in sorted(texts)]


def _rendered(kind: str, name: str) -> dict[str, str]:
    """The package's files: path below its folder, and text."""
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
