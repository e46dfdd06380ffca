"""Checkpoints: a folder of files that is whole or not there, and says so when it is damaged.

    <name>/<part>.pt        one file per part, written by torch.save, read with weights_only=True and nothing else
    <name>/manifest.json    format, meta, size and sha256 of each file, blocks, sha256 of itself; written last
    .blocks/                large arrays in pieces, which checkpoints share (`karolos.blocks`)

A checkpoint is written beside the old one and takes its place by renaming. Killed between the two renames, the old one
still lies in `.<name>.previous`, where `load` finds it.
"""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import re
import shutil
from collections.abc import Collection, Mapping
from io import BufferedReader
from pathlib import Path
from typing import Any, BinaryIO

from .blocks import BlockError, Blocks
from .core import State
from .encoding import decode, encode
from .errors import RunError
from .files import below, parse_object, sync_folder, writing

FORMAT = 1
"""Version of the encoding and of the manifest."""
_PART = re.compile(r"[a-z][a-z0-9_]{0,31}")
_PREVIOUS = re.compile(r"\.(.*)\.previous")
_MANIFEST = "manifest.json"
_BLOCKS = ".blocks"
_MANIFEST_BYTES = 1 << 24
_MALFORMED = (RuntimeError, ValueError, KeyError, TypeError, AttributeError, AssertionError, EOFError, OverflowError)
"""What torch's reader and `decode` raise on files that were made to look like checkpoints."""


class CheckpointError(RunError):
    """A checkpoint that is missing, damaged, from a newer karolos or not to be trusted."""


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
                part: _write_part(fresh / f"{part}.pt", encode(state, part, blocks)) for part, state in parts.items()
            }
            blocks.sync()
            _write_manifest(fresh, {"meta": dict(meta), "files": files, "blocks": sorted(blocks.used)})
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
    meta: dict[str, Any] = _read_manifest(_find(folder, name))["meta"]
    return meta


def digest(folder: Path, name: str, part: str) -> str:
    """The sha256 (hex) of a part of a checkpoint, as its manifest says. Raises as `read_meta` does, and KeyError."""
    sha256: str = _read_manifest(_find(folder, name))["files"][part]["sha256"]
    return sha256


def names(folder: Path) -> tuple[str, ...]:
    """Names of the checkpoints in a folder that `load` would try."""
    if not os.path.isdir(folder):
        return ()
    found = {_PREVIOUS.sub(r"\1", path.name) for path in folder.iterdir() if path.is_dir()}
    return tuple(sorted(name for name in found if _PART.fullmatch(name)))


def _load(path: Path, only: Collection[str] | None) -> tuple[dict[str, State], dict[str, Any]]:
    manifest = _read_manifest(path)
    parts = {
        part: _read_part(path / f"{part}.pt", facts)
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
                keep.update(_read_manifest(path).get("blocks", ()))
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


def _read_manifest(path: Path) -> dict[str, Any]:
    """Manifest of the checkpoint in the folder `path`, verified in itself: format, meta, files."""
    try:
        with (path / _MANIFEST).open("rb") as file:
            manifest = parse_object(file.read(_MANIFEST_BYTES))
    except OSError as error:
        raise _damaged(path, f"its {_MANIFEST} is missing ({error.strerror})") from error
    if manifest is None:
        raise _damaged(path, f"its {_MANIFEST} cannot be read")
    version = manifest.get("format")
    if isinstance(version, int) and version > FORMAT:
        raise CheckpointError(
            f"the checkpoint has format {version}, this karolos knows {FORMAT}", where=str(path), hint="update karolos"
        )
    files = manifest.get("files")
    sound = (
        manifest.get("sha256") == _digest(manifest)
        and isinstance(manifest.get("meta"), dict)
        and isinstance(files, dict)
        and all(_PART.fullmatch(part) for part in files)
    )
    if not sound:
        raise _damaged(path, f"its {_MANIFEST} was changed")
    return manifest


def _check_names(name: str, parts: Mapping[str, State]) -> None:
    for text in (name, *parts):
        if not _PART.fullmatch(text):
            raise ValueError(f"{text!r} cannot name a checkpoint or a part: lower-case letters, digits, underscores")


class _Sink:
    """A file that hashes what is written to it and keeps the system's own error, which torch replaces by another."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._sha256 = hashlib.sha256()
        self.size = 0
        self.error: OSError | None = None

    def write(self, data: bytes | memoryview) -> int:
        try:
            self._file.write(data)
        except OSError as error:
            self.error = error
            raise
        self._sha256.update(data)
        self.size += len(data)
        return len(data)

    def flush(self) -> None:
        self._file.flush()

    def facts(self) -> dict[str, Any]:
        return {"bytes": self.size, "sha256": self._sha256.hexdigest()}


def _write_part(path: Path, state: Any) -> dict[str, Any]:
    """Write one part for good; returns its size and hash."""
    import torch  # noqa: PLC0415

    with path.open("wb") as file:
        sink = _Sink(file)
        try:
            torch.save(state, sink)  # type: ignore[arg-type]  # it writes and never seeks
        except RuntimeError as error:
            if sink.error is None:
                raise
            raise sink.error from error
        file.flush()
        os.fsync(file.fileno())
    return sink.facts()


def _write_manifest(path: Path, content: Mapping[str, Any]) -> None:
    manifest: dict[str, Any] = {"format": FORMAT, **content}
    manifest["sha256"] = _digest(manifest)
    with (path / _MANIFEST).open("w", encoding="utf-8", newline="\n") as file:
        json.dump(manifest, file, indent=2, allow_nan=False)
        file.flush()
        os.fsync(file.fileno())
    sync_folder(path)


def _digest(manifest: Mapping[str, Any]) -> str:
    """sha256 of a manifest without its own."""
    rest = {key: value for key, value in manifest.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


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


def _read_part(path: Path, facts: Any) -> State:
    """One part, verified against its size and hash in the manifest and read from the same open file."""
    import torch  # noqa: PLC0415

    try:
        with path.open("rb") as file:
            _verify(file, facts, path)
            file.seek(0)
            state = decode(
                torch.load(file, map_location="cpu", weights_only=True), Blocks(path.parent.parent / _BLOCKS)
            )
    except OSError as error:
        raise _damaged(path, f"it cannot be read ({error.strerror})") from error
    except BlockError as error:
        raise _damaged(path, str(error)) from error
    except (pickle.UnpicklingError, *_MALFORMED) as error:
        raise CheckpointError(
            "the checkpoint holds what is no plain state, and was not loaded",
            where=str(path),
            hint="it may run foreign code: do not load it by other means unless you wrote it yourself",
        ) from error
    if not isinstance(state, dict):
        raise _damaged(path, "it holds no state")
    return state


def _verify(file: BufferedReader, facts: Any, path: Path) -> None:
    size = os.fstat(file.fileno()).st_size
    if size != facts["bytes"]:
        raise _damaged(path, f"it has {size:,} bytes of {facts['bytes']:,}")
    if hashlib.file_digest(file, "sha256").hexdigest() != facts["sha256"]:
        raise _damaged(path, "its content was changed")


def _damaged(path: Path, why: str) -> CheckpointError:
    return CheckpointError(
        f"the checkpoint is damaged: {why}", where=str(path), hint="use another checkpoint of the run, or train again"
    )
