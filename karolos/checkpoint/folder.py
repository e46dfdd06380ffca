"""Checkpoints in a folder: saved whole or not at all, found, loaded, renamed, and blocks that none needs removed."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from ..core import State
from ..files import below, sync_folder, writing
from .array_files import Blocks
from .encoding import encode
from .errors import CheckpointError
from .manifest import PART, read_manifest, write_manifest
from .parts import read_part, write_part

_PREVIOUS = re.compile(r"\.(.*)\.previous")
_BLOCKS = ".blocks"


def save(folder: Path, name: str, parts: Mapping[str, State], meta: Mapping[str, Any]) -> Path:
    """Write a checkpoint and put it in the place of an older one of that name.

    Args:
        folder: where the checkpoints of the run lie; made if it is not there.
        name: e.g. "best" or "last".
        parts: nested dictionaries, lists and tuples of tensors, numpy arrays, numbers, strings, booleans and None.
        meta: JSON values that say what it is (experiment, steps ...).

    Returns:
        The checkpoint's folder.

    Raises:
        MachineError: the disk is full or the folder cannot be written; the older checkpoint is kept.
        TypeError: a state holds something else; names the key path.
    """
    _check_names(name, parts)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    target = below(folder, name)
    fresh = folder / f".{name}.new"
    with writing(target):
        try:
            shutil.rmtree(fresh, ignore_errors=True)  # what a killed process left
            fresh.mkdir()
            blocks = Blocks(folder / _BLOCKS)
            files = {
                part: write_part(fresh / f"{part}.pt", encode(state, part, blocks)) for part, state in parts.items()
            }
            blocks.sync()
            write_manifest(fresh, {"meta": dict(meta), "files": files, "blocks": sorted(blocks.used)})
        except BaseException:  # an interrupt, too, leaves nothing behind
            shutil.rmtree(fresh, ignore_errors=True)
            raise
        _put_in_place(fresh, target)
        _sweep(folder)
    return target


def rename(folder: Path, name: str, other: str) -> None:
    """Give a checkpoint another name, in the place of one that had it; nothing happens when there is none.

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
        folder: where the checkpoints of the run lie.
        name: of the checkpoint.
        only: parts to read; all of them unless told otherwise.

    Raises:
        CheckpointError: it is missing, truncated, changed, from a newer karolos, or holds what is no plain state.
    """
    path = _find(folder, name)
    before = _identity(path)
    try:
        return _load(path, only)
    except CheckpointError:
        if _identity(_find(folder, name)) == before:
            raise
    return load(folder, name, only)  # a run that goes on put a new one in its place while this one was read


def read_meta(folder: Path, name: str) -> dict[str, Any]:
    """The meta of a checkpoint; of its files only the manifest is looked at.

    Raises:
        CheckpointError: the manifest is missing, damaged or of a newer format.
    """
    meta: dict[str, Any] = read_manifest(_find(folder, name))["meta"]
    return meta


def digest(folder: Path, name: str, part: str) -> str:
    """The sha256 (hex) of a part of a checkpoint, as its manifest says. Raises as `read_meta` does, and KeyError."""
    sha256: str = read_manifest(_find(folder, name))["files"][part]["sha256"]
    return sha256


def names(folder: Path) -> tuple[str, ...]:
    """Names of the checkpoints in a folder that `load` would try."""
    if not os.path.isdir(folder):
        return ()
    found = {_PREVIOUS.sub(r"\1", path.name) for path in folder.iterdir() if path.is_dir()}
    return tuple(sorted(name for name in found if PART.fullmatch(name)))


def _load(path: Path, only: Collection[str] | None) -> tuple[dict[str, State], dict[str, Any]]:
    manifest = read_manifest(path)
    blocks = Blocks(path.parent / _BLOCKS)
    parts = {
        part: read_part(path / f"{part}.pt", facts, blocks)
        for part, facts in manifest["files"].items()
        if only is None or part in only
    }
    return parts, manifest["meta"]


def _sweep(folder: Path) -> None:
    """Remove blocks that no checkpoint uses. One whose manifest cannot be read might: then all are kept."""
    keep: set[str] = set()
    for path in folder.iterdir():
        if path.is_dir() and path.name != _BLOCKS and not path.name.endswith(".new"):
            try:
                keep.update(read_manifest(path).get("blocks", ()))
            except CheckpointError:
                return
    Blocks(folder / _BLOCKS).sweep(keep)


def _identity(path: Path) -> tuple[int, int] | None:
    """What tells this folder from another one of the same name."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns


def _check_names(name: str, parts: Mapping[str, State]) -> None:
    for text in (name, *parts):
        if not PART.fullmatch(text):
            raise ValueError(f"{text!r} cannot name a checkpoint or a part: lower-case letters, digits, underscores")


def _previous(target: Path) -> Path:
    return target.with_name(f".{target.name}.previous")


def _put_in_place(fresh: Path, target: Path) -> None:
    previous = _previous(target)
    if target.exists():
        shutil.rmtree(previous, ignore_errors=True)
        target.rename(previous)
    fresh.rename(target)
    sync_folder(target.parent)
    shutil.rmtree(previous, ignore_errors=True)


def _find(folder: Path, name: str) -> Path:
    path = below(folder, name)
    for candidate in (path, _previous(path), path):  # it may come into place between two looks
        if os.path.isdir(candidate):
            return candidate
    there = ", ".join(names(folder)) or "none"
    raise CheckpointError(f"there is no checkpoint {name!r}", where=str(folder), hint=f"there are: {there}")
