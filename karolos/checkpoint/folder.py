"""Checkpoints in a folder: save (completely or not at all), find, load, rename; remove array files that none uses."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from .. import system
from ..core import State
from ..files import below, writing
from .array_files import ArrayFiles
from .manifest import PART, CheckpointError, damaged, read_manifest, write_manifest
from .state_file import read_state, write_state

_PREVIOUS = re.compile(r"\.(.*)\.previous")
_ARRAYS = ".arrays"


def save(folder: Path, name: str, parts: Mapping[str, State], meta: Mapping[str, Any]) -> Path:
    """Write a checkpoint; it replaces an older one of that name.

    Args:
        folder: the run's folder of checkpoints; created if it does not exist.
        name: e.g. "best" or "last".
        parts: nested dictionaries, lists and tuples of tensors, numpy arrays, numbers, strings, booleans and None.
        meta: JSON values (experiment, steps ...).

    Returns:
        The checkpoint's folder.

    Raises:
        MachineError: the disk is full or the folder cannot be written; the older checkpoint stays.
        TypeError: a state holds something else; names the key path.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    target = below(folder, name)
    fresh = folder / f".{name}.new"
    with writing(target):
        try:
            system.remove_tree(fresh, ignore_errors=True)  # left by a killed process
            fresh.mkdir()
            arrays = ArrayFiles(folder / _ARRAYS)
            files = {part: write_state(fresh / f"{part}.pt", state, arrays) for part, state in parts.items()}
            arrays.sync()
            write_manifest(fresh, {"meta": dict(meta), "files": files, "array_files": sorted(arrays.used)})
        except BaseException:  # also after an interrupt nothing is left behind
            system.remove_tree(fresh, ignore_errors=True)
            with suppress(OSError):
                _remove_unused(folder)
            raise
        _put_in_place(fresh, target)
        _remove_unused(folder)
    return target


def rename(folder: Path, name: str, other: str) -> None:
    """Rename a checkpoint; it replaces one of the new name. Does nothing if there is none.

    Raises:
        MachineError: the folder cannot be written.
    """
    source, target = below(folder, name), below(folder, other)
    if source.is_dir():
        with writing(target):
            _put_in_place(source, target)


def load(folder: Path, name: str, only: Collection[str] | None = None) -> tuple[dict[str, State], dict[str, Any]]:
    """Read a checkpoint: its parts and its meta.

    Args:
        folder: the run's folder of checkpoints.
        name: of the checkpoint.
        only: parts to read; all by default.

    Raises:
        CheckpointError: it is missing, truncated, changed, from a newer karolos, or does not hold plain states.
    """
    parts, manifest = _load(folder, name, only)
    return parts, manifest["meta"]


def load_part(folder: Path, name: str, part: str) -> tuple[State, dict[str, Any], str]:
    """Read one part of a checkpoint: the part, the checkpoint's meta, and the part's sha256 as `digest` gives it.

    All three are of the same checkpoint, also where the run replaces it meanwhile. Raises as `load` does.
    """
    parts, manifest = _load(folder, name, (part,))
    return parts[part], manifest["meta"], manifest["files"][part]["sha256"]


def read_meta(folder: Path, name: str) -> dict[str, Any]:
    """The meta of a checkpoint; only its manifest is read.

    Raises:
        CheckpointError: the manifest is missing, damaged or of a newer format.
    """
    meta: dict[str, Any] = read_manifest(_find(folder, name))["meta"]
    return meta


def digest(folder: Path, name: str, part: str) -> str:
    """The sha256 (hex) of a part of a checkpoint, as its manifest says. Raises as `load` does."""
    path = _find(folder, name)
    facts = read_manifest(path)["files"].get(part)
    if not isinstance(facts, dict) or not isinstance(facts.get("sha256"), str):
        raise damaged(path, f"it lacks {part}")
    sha256: str = facts["sha256"]
    return sha256


def names(folder: Path) -> tuple[str, ...]:
    """Names of the checkpoints in a folder that `load` would try."""
    if not os.path.isdir(folder):
        return ()
    found = {_PREVIOUS.sub(r"\1", path.name) for path in folder.iterdir() if path.is_dir()}
    return tuple(sorted(name for name in found if PART.fullmatch(name)))


def _load(folder: Path, name: str, only: Collection[str] | None) -> tuple[dict[str, State], dict[str, Any]]:
    """The parts of a checkpoint and its manifest."""
    path = _find(folder, name)
    before = _identity(path)
    try:
        return _read(path, only)
    except CheckpointError:
        if _identity(_find(folder, name)) == before:
            raise
    return _load(folder, name, only)  # the run replaced it while it was read


def _read(path: Path, only: Collection[str] | None) -> tuple[dict[str, State], dict[str, Any]]:
    manifest = read_manifest(path)
    if lacking := set(only or ()) - set(manifest["files"]):
        raise damaged(path, f"it lacks {', '.join(sorted(lacking))}")
    arrays = ArrayFiles(path.parent / _ARRAYS)
    parts = {
        part: read_state(path / f"{part}.pt", facts, arrays)
        for part, facts in manifest["files"].items()
        if only is None or part in only
    }
    return parts, manifest


def _remove_unused(folder: Path) -> None:
    """Remove array files that no checkpoint uses. If a manifest cannot be read, it might use any, and all stay."""
    used: set[str] = set()
    for path in folder.iterdir():
        if path.is_dir() and path.name != _ARRAYS and not path.name.endswith(".new"):
            try:
                used.update(map(str, read_manifest(path).get("array_files", ())))
            except CheckpointError:
                return
    ArrayFiles(folder / _ARRAYS).remove_unused(used)


def _identity(path: Path) -> tuple[int, int] | None:
    """Distinguishes this folder from another one of the same name."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns


def _previous(target: Path) -> Path:
    return target.with_name(f".{target.name}.previous")


def _put_in_place(fresh: Path, target: Path) -> None:
    previous = _previous(target)
    if target.exists():
        system.remove_tree(previous, ignore_errors=True)
        system.replace(target, previous)
    system.replace(fresh, target)
    system.sync_folder(target.parent)
    system.remove_tree(previous, ignore_errors=True)


def _find(folder: Path, name: str) -> Path:
    path = below(folder, name)
    for candidate in (path, _previous(path), path):  # it may be renamed between two attempts
        if os.path.isdir(candidate):
            return candidate
    existing = ", ".join(names(folder)) or "no checkpoints"
    raise CheckpointError(f"there is no checkpoint {name!r}", where=str(folder), hint=f"there are {existing}")
