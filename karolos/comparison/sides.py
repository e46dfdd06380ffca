"""What two runs were made from, or a run of a spec would be made from now, and how they differ."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..records import RunFolder, provenance
from ..specification import Spec
from ..store.rows import without_seeds
from .differences import MISSING, differences

_FILE = re.compile(r"^diff --git a/.* b/(.*)$", re.MULTILINE)


@dataclass(frozen=True)
class Side:
    """One of the two: resolved spec, versions by package, seed, git commit, and the changes since that commit."""

    name: str
    spec: Mapping[str, Any]
    versions: Mapping[str, str]
    seed: int | None
    commit: str | None
    patch: str


@dataclass(frozen=True)
class SideDifference:
    """One thing that differs; MISSING on the side that lacks it.

    Args:
        part: run, spec, version or code.
        key: key path of the spec, package, or file.
    """

    part: str
    key: str
    a: Any
    b: Any

    def row(self) -> dict[str, Any]:
        """As JSON values: null for a side that lacks it; `missing` names that side."""
        sides = {"a": self.a, "b": self.b}
        missing = next((side for side, value in sides.items() if value is MISSING), None)
        values = {side: None if value is MISSING else value for side, value in sides.items()}
        return {"part": self.part, "key": self.key, **values, "missing": missing}


def of_run(folder: RunFolder) -> Side:
    """What a run was made from, according to its folder."""
    about = folder.description()
    path = folder.path / "code.diff"
    return Side(
        name=folder.id,
        spec=folder.spec(),
        versions=about.get("versions") or {},
        seed=about["seed"],
        commit=(about.get("git") or {}).get("commit"),
        patch=path.read_text("utf-8", "replace") if path.is_file() else "",
    )


def of_spec(spec: Spec, name: str) -> Side:
    """What a run of this spec would be made from now, in the current folder."""
    code = provenance.code(Path.cwd())
    return Side(
        name, spec.dump(), provenance.versions(), None, code.commit if code else None, code.diff if code else ""
    )


def compare_sides(a: Side, b: Side) -> Iterator[SideDifference]:
    """Everything that differs: seed, settings, versions, commit, changed files."""
    if a.seed is not None and b.seed is not None and a.seed != b.seed:
        yield SideDifference("run", "seed", a.seed, b.seed)
    for key, (one, other) in differences([without_seeds(a.spec), without_seeds(b.spec)]).items():
        yield SideDifference("spec", key, one, other)
    for key, (one, other) in differences([a.versions, b.versions]).items():
        yield SideDifference("version", key, one, other)
    if a.commit != b.commit:
        yield SideDifference("code", "commit", a.commit or MISSING, b.commit or MISSING)
    ours, theirs = _changed(a.patch), _changed(b.patch)
    for file in sorted({*ours, *theirs}):
        if ours.get(file) != theirs.get(file):
            one, other = (_lines(side[file]) if file in side else MISSING for side in (ours, theirs))
            yield SideDifference("code", file, one, other)


def _changed(patch: str) -> dict[str, str]:
    """File name -> its part of a patch."""
    _, *pieces = _FILE.split(patch)
    return dict(zip(pieces[::2], pieces[1::2], strict=True))


def _lines(patch: str) -> str:
    """The numbers of added and removed lines of a file."""
    lines = patch.splitlines()
    added = sum(line.startswith("+") and not line.startswith("+++") for line in lines)
    removed = sum(line.startswith("-") and not line.startswith("---") for line in lines)
    return f"changed: +{added} -{removed}"
