"""Differences between specs, and between the settings, versions and sources of two runs."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, Final

from ..records import RunFolder, provenance
from ..records.run_records import without_seeds

_FILE = re.compile(r"^diff --git a/.* b/(.*)$", re.MULTILINE)


class Missing(Enum):
    """The value of a key that a mapping lacks, which differs from null."""

    MISSING = "-"


MISSING: Final = Missing.MISSING


def differences(mappings: Sequence[Mapping[str, Any]]) -> dict[str, tuple[Any, ...]]:
    """Key path -> each mapping's value, for keys whose values differ. Keys are grouped by their first part.

    If a side lacks a block, for example because it has another plugin, each key of the block is a value of its own.
    A list is one value.
    """
    found: dict[str, tuple[Any, ...]] = {}
    for key in dict.fromkeys(key for mapping in mappings for key in mapping):
        values = tuple(mapping.get(key, MISSING) for mapping in mappings)
        if all(value == values[0] for value in values):
            continue
        blocks = [value if isinstance(value, Mapping) and value else {} for value in values]
        own = tuple(MISSING if block else value for block, value in zip(blocks, values, strict=True))
        found |= {key: own} if any(value is not MISSING for value in own) else {}
        found |= {f"{key}.{name}": each for name, each in differences(blocks).items()}
    return found


@dataclass(frozen=True)
class Side:
    """One side: resolved spec, versions, sources by package or file, seed, git commit, and changes since the commit."""

    name: str
    spec: Mapping[str, Any]
    versions: Mapping[str, str]
    sources: Mapping[str, str]
    seed: int | None
    commit: str | None
    patch: str


def of_run(folder: RunFolder) -> Side:
    """The side of a run, according to its folder."""
    about = folder.description()
    path = folder.path / "code.diff"
    return Side(
        name=folder.id,
        spec=folder.spec(),
        versions=about.get("versions") or {},
        sources={**(about.get("sources") or {}), **(about.get("files") or {})},
        seed=about["seed"],
        commit=(about.get("git") or {}).get("commit"),
        patch=path.read_text("utf-8", "replace") if path.is_file() else "",
    )


def of_spec(resolved: Mapping[str, Any], files: Mapping[str, str], name: str) -> Side:
    """The side of a run of a resolved spec with these files (`Spec.files`), as it would be now in this folder."""
    git, patch = provenance.code(Path.cwd()) or ({}, "")
    sources = provenance.sources(provenance.packages(resolved)) | {**files}
    return Side(name, resolved, provenance.versions(), sources, None, git.get("commit"), patch)


def compare_sides(a: Side, b: Side) -> Iterator[dict[str, Any]]:
    """Everything that differs: seed, settings, versions, commit, changed files. A JSON object for each.

    `part` is run, spec, version, source or code, `key` a key path, package or file, `missing` the side that lacks it.
    """
    if a.seed is not None and b.seed is not None and a.seed != b.seed:
        yield _row("run", "seed", a.seed, b.seed)
    for key, pair in differences([without_seeds(a.spec), without_seeds(b.spec)]).items():
        yield _row("spec", key, *pair)
    for key, pair in differences([a.versions, b.versions]).items():
        yield _row("version", key, *pair)
    for key in sorted(a.sources.keys() & b.sources.keys()):  # not known of older runs
        if a.sources[key] != b.sources[key]:
            yield _row("source", key, a.sources[key][:12], b.sources[key][:12])
    if a.commit != b.commit:
        yield _row("code", "commit", a.commit or MISSING, b.commit or MISSING)
    ours, theirs = _changed(a.patch), _changed(b.patch)
    for file in sorted({*ours, *theirs}):
        if ours.get(file) != theirs.get(file):
            yield _row("code", file, *(_lines(side[file]) if file in side else MISSING for side in (ours, theirs)))


def _row(part: str, key: str, a: Any, b: Any) -> dict[str, Any]:
    sides = {"a": a, "b": b}
    missing = next((side for side, value in sides.items() if value is MISSING), None)
    values = {side: None if value is MISSING else value for side, value in sides.items()}
    return {"part": part, "key": key, **values, "missing": missing}


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
