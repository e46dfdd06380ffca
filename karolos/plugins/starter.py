"""Starter packages: a small, complete and tested plugin of each kind, to be changed step by step.

A robot or a gripper can be written from a URDF; see `karolos.robots.proposal`.
"""

from __future__ import annotations

import keyword
import re
import shutil
from importlib.metadata import entry_points
from importlib.resources import files
from pathlib import Path
from string import Template

from karolos_deploy.drivers import GROUP as DRIVERS

from ..errors import UsageError, alternatives
from ..registry import entries

KINDS = ("robot", "gripper", "task", "agent", "buffer", "environment", "distribution", "driver")
"""Kinds with a starter package."""
LONGEST = 60
"""Largest number of characters of a plugin's name."""


def write_starter(
    kind: str,
    name: str,
    out: Path,
    *,
    urdf: Path | None = None,
    tool: str | None = None,
    gripper: str | None = None,
) -> tuple[list[Path], tuple[str, ...]]:
    """Write the package `karolos-<name>` into `out`; returns its files, sorted, and the assumptions about the URDF.

    A robot or a gripper is written from `urdf`, if given. `tool` is the link of its tool frame, and `gripper` replaces
    the hand of a robot's URDF.

    Raises UsageError if kind or name is invalid, another package has the name, or the folder cannot be written;
    PluginError if karolos cannot simulate the URDF.
    """
    if kind not in KINDS:
        raise UsageError(f"there is no starter for {kind!r}", hint=alternatives(kind, KINDS))
    reserved = keyword.iskeyword(name) or name in ("null", "true", "false")  # these are no names in YAML
    if not re.fullmatch(r"[a-z](_?[a-z0-9])*", name) or reserved or len(name) > LONGEST:
        raise UsageError(
            f"{name!r} cannot be the name of a plugin",
            hint=f"at most {LONGEST} lower-case letters, digits and single underscores, beginning with a letter, not a "
            "keyword of Python or YAML",
        )
    for other, package in _installed(kind):
        if other == name and package != f"karolos-{name.replace('_', '-')}":
            what = f"the package {package} has a {kind} called {name!r} already"
            raise UsageError(what, hint="choose another name")
    if urdf is not None and kind not in ("robot", "gripper"):
        raise UsageError(f"a {kind} has no URDF", where="--urdf", hint="leave it out, or write a robot or a gripper")
    if tool is not None and urdf is None:
        raise UsageError("is only for a URDF", where="--tool", hint="add --urdf FILE")
    if gripper is not None and (kind != "robot" or urdf is None):
        raise UsageError("is only for a robot with a URDF", where="--gripper", hint="write a robot with --urdf FILE")
    contents, notes = _rendered(kind, name, urdf, tool, gripper)
    try:
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise UsageError("already exists", where=str(out), hint="name another folder with --out DIR")
        for path, content in contents.items():
            (out / path).parent.mkdir(parents=True, exist_ok=True)
            if isinstance(content, Path):
                shutil.copyfile(content, out / path)
            else:
                (out / path).write_text(content, "utf-8", "surrogateescape")
    except OSError as error:
        raise UsageError(f"cannot be written: {error.strerror}", where=str(out)) from error
    return [out / path for path in sorted(contents)], notes


def _installed(kind: str) -> list[tuple[str, str]]:
    """Names and packages of the installed plugins of a kind."""
    if kind == "driver":
        return [(one.name, one.dist.name) for one in entry_points(group=DRIVERS) if one.dist is not None]
    return [(entry.name, entry.distribution) for entry in entries(f"{kind}s")]


def _rendered(
    kind: str, name: str, urdf: Path | None, tool: str | None, gripper: str | None
) -> tuple[dict[str, str | Path], tuple[str, ...]]:
    """The package, by paths below its folder: texts and files to copy; and notes."""
    class_name = "".join(word.capitalize() for word in name.split("_"))
    values = {
        "kind": kind,
        "name": name,
        "dashed": name.replace("_", "-"),
        "threshold": "0.05",
        "group": DRIVERS if kind == "driver" else f"karolos.{kind}s",
        "needs": "" if kind == "driver" else '"karolos"',  # a robot's computer has only karolos-deploy
    }
    folder, package = files("karolos.plugins") / "starters", f"src/karolos_{name}"
    templates = {
        "pyproject.toml": "pyproject.toml",
        "README.md": "README_driver.md" if kind == "driver" else "README.md",
        f"{package}/__init__.py": "__init__.py",
        f"{package}/{name}.py": "robot_from_urdf.py" if kind == "robot" and urdf is not None else f"{kind}.py",
        f"tests/test_{name}.py": f"test_{kind}.py",
    }
    contents: dict[str, str | Path] = {}
    notes: tuple[str, ...] = ()
    if kind in ("robot", "gripper"):
        templates[f"{package}/{name}.urdf"] = f"{kind}.urdf"
    if kind == "robot":
        templates[f"specs/{name}_reach.yaml"] = "reach.yaml"
    if kind == "task":
        templates[f"{package}/part.obj"] = "part.obj"
    if kind == "gripper":
        from ..robots.proposal import propose_gripper  # noqa: PLC0415

        model = folder / "gripper.urdf.txt" if urdf is None else urdf
        code, found = propose_gripper(Path(str(model)), tool)
        values.update(code)
        notes = () if urdf is None else found
    if urdf is not None:
        from ..robots.proposal import Known, propose, with_meshes  # noqa: PLC0415 (takes half a second)

        del templates[f"{package}/{name}.urdf"]
        if kind == "robot":
            proposal = propose(urdf, gripper, Known(tool))
            values.update(proposal.code())
            notes = proposal.notes
        contents[f"{package}/{name}.urdf"], meshes = with_meshes(urdf)
        contents |= {f"{package}/{path}": file for path, file in meshes.items()}
    texts = {path: (folder / f"{template}.txt").read_text(encoding="utf-8") for path, template in templates.items()}
    taken = re.findall(r"\w+", "\n".join([texts[f"{package}/{name}.py"], *values.values()]))
    values["class_name"] = class_name + kind.capitalize() * (class_name in taken)  # as BoxTask: it uses the class Box
    contents |= {path: Template(text).substitute(values) for path, text in texts.items()}
    return contents, notes
