"""Checkpoints: folders that are complete or missing, and detect damage.

    <name>/<part>.pt        one file per part, written by torch.save, read with weights_only=True and nothing else
    <name>/manifest.json    format, meta, size and sha256 of each file, array files, sha256 of itself; written last
    .arrays/                large arrays in files of 1 MiB that are named by their content and shared by checkpoints

A new checkpoint is written into another folder and then replaces the old one by renaming. If the process is killed
between the two renames, `load` finds the old one in `.<name>.previous`.

Torch's safe reader knows only tensors, containers and plain values. Therefore a numpy array is stored as a tensor of
its bytes with dtype and shape, and an integer of more than 64 bits as hexadecimal text; both are dictionaries with the
key `__karolos__`. A large array is stored in array files, and the dictionary names them: a replay buffer of a gigabyte
changes little between two checkpoints, and only the files that changed are written. All come back bit for bit: dtype,
shape, byte order, NaN payloads, -0.0. Arrays come back in C order, mappings as plain dictionaries, tensors on the CPU.
Torch is imported when a function is called.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import pickle
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from .. import system
from ..errors import RunError
from ..system.files import below, parse_object, write_json, writing

FORMAT = 1
"""Version of the encoding and of the manifest."""
PART = re.compile(r"[a-z][a-z0-9_]{0,31}")
"""Names of checkpoints and of their parts."""
LARGE = 1 << 18
"""Smallest array that is stored in array files, in bytes."""
SIZE = 1 << 20
"""Bytes of an array file; the last file of an array is shorter."""
_ARRAY_NAME = re.compile(r"[0-9a-f]{64}")
_SOUND: set[Path] = set()
"""Files that this process has written or compared, so that it need not read them again."""
_MANIFEST, _ARRAYS = "manifest.json", ".arrays"
_MANIFEST_BYTES = 1 << 24
_PREVIOUS = re.compile(r"\.(.*)\.previous")
_TAG = "__karolos__"
_WORD = range(-(1 << 63), 1 << 63)
State = dict[str, Any]
"""The content of a part, see `karolos.core.State`."""
_MALFORMED = (RuntimeError, ValueError, KeyError, TypeError, AttributeError, AssertionError, EOFError, OverflowError)
"""Errors of torch's reader and `decode` on files that only look like checkpoints."""


class ArrayFileError(ValueError):
    """An array file that is missing, damaged or has an invalid name."""


class ArrayFiles:
    """The array files in one folder, which is created with the first file."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.used: set[str] = set()
        """Names that `write` returned: `remove_unused` must keep them."""

    def write(self, data: np.ndarray) -> list[str]:
        """Write the bytes of a flat uint8 array to the disk; returns the names of its files (sha256), in order.

        Raises OSError if the disk is full or the folder cannot be written; every file is complete or missing.
        """
        view = data.data
        names = [self._write_file(view[start : start + SIZE]) for start in range(0, len(view), SIZE)]
        self.used.update(names)
        return names

    def read(self, names: Sequence[str], size: int) -> np.ndarray:
        """The `size` bytes that `write` wrote: a flat uint8 array.

        Raises ArrayFileError if a file is missing or damaged.
        """
        found = np.empty(size, np.uint8)
        start = 0
        for name in names:
            if not isinstance(name, str) or not _ARRAY_NAME.fullmatch(name):
                raise ArrayFileError(f"{name!r} is not the name of an array file")
            try:
                data = (self.folder / name).read_bytes()
            except OSError as error:
                raise ArrayFileError(f"the array file {name[:12]} cannot be read ({error.strerror})") from error
            if hashlib.sha256(data).hexdigest() != name or start + len(data) > size:
                raise ArrayFileError(f"the array file {name[:12]} was changed")
            found[start : start + len(data)] = np.frombuffer(data, np.uint8)
            start += len(data)
        if start != size:
            raise ArrayFileError(f"the array files hold {start:,} bytes instead of {size:,}")
        return found

    def remove_unused(self, used: Collection[str]) -> None:
        """Remove files that no checkpoint uses, also those that a killed process left incomplete."""
        if not self.folder.is_dir():
            return
        for path in self.folder.iterdir():
            if path.name not in used:
                system.remove(path, missing_ok=True)
                _SOUND.discard(path)

    def _write_file(self, data: memoryview) -> str:
        name = hashlib.sha256(data).hexdigest()
        place = self.folder / name
        complete = place.exists() and place.stat().st_size == len(data)
        if complete and (place in _SOUND or place.read_bytes() == data):  # later checkpoints would use a damaged one
            _SOUND.add(place)
            return name
        self.folder.mkdir(parents=True, exist_ok=True)
        fresh = self.folder / f".{name}.{os.getpid()}"
        _write_synced(fresh, data)
        system.replace(fresh, place)
        _SOUND.add(place)
        return name


class CheckpointError(RunError):
    """A checkpoint that is missing, damaged, from a newer karolos or unsafe to load."""


def save(folder: Path, name: str, parts: Mapping[str, State], meta: Mapping[str, Any]) -> Path:
    """Write a checkpoint into a run's folder of them and return its own; it replaces an older one of that name.

    `parts` are nested dictionaries, lists and tuples of tensors, numpy arrays, numbers, strings, booleans and None.
    `meta` are JSON values (experiment, steps ...).

    Raises MachineError if the disk is full or the folder cannot be written (the older checkpoint stays), TypeError with
    the key path if a state holds something else.
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
            files = {}
            for part, state in parts.items():
                data = pack_state(state, part, arrays)
                _write_synced(fresh / f"{part}.pt", data)
                files[part] = {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
            if arrays.used:  # the names of their files survive a power cut, too
                system.sync_folder(arrays.folder)
            content = {"format": FORMAT, "meta": dict(meta), "files": files, "array_files": sorted(arrays.used)}
            write_json(fresh / _MANIFEST, content | {"sha256": seal(content)})
        except BaseException:  # nothing is left behind after an interrupt, either
            system.remove_tree(fresh, ignore_errors=True)
            with suppress(OSError):
                _remove_unused(folder)
            raise
        _put_in_place(fresh, target)
        _remove_unused(folder)
    return target


def rename(folder: Path, name: str, other: str) -> None:
    """Rename a checkpoint; it replaces one of the new name. Does nothing if there is none.

    Raises MachineError if the folder cannot be written.
    """
    source, target = below(folder, name), below(folder, other)
    if source.is_dir():
        with writing(target):
            _put_in_place(source, target)


def load(folder: Path, name: str, only: Collection[str] | None = None) -> tuple[dict[str, State], dict[str, Any]]:
    """Read a checkpoint: its parts, all or `only` some, and its meta.

    Raises CheckpointError if it is missing, truncated, changed, from a newer karolos, or does not hold plain states.
    """
    parts, manifest = _load(folder, name, only)
    return parts, manifest["meta"]


def load_part(folder: Path, name: str, part: str) -> tuple[State, dict[str, Any], str]:
    """Read one part of a checkpoint: the part, the checkpoint's meta, and the part's sha256 as `digest` gives it.

    All three belong to the same checkpoint, even if the run replaces it during the call. Raises as `load` does.
    """
    parts, manifest = _load(folder, name, (part,))
    return parts[part], manifest["meta"], manifest["files"][part]["sha256"]


def read_meta(folder: Path, name: str) -> dict[str, Any]:
    """The meta of a checkpoint; only its manifest is read.

    Raises CheckpointError if the manifest is missing, damaged or of a newer format.
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
    """Names of the checkpoints in a folder, complete or damaged."""
    if not os.path.isdir(folder):
        return ()
    found = {_PREVIOUS.sub(r"\1", path.name) for path in folder.iterdir() if path.is_dir()}
    return tuple(sorted(name for name in found if PART.fullmatch(name)))


def _load(folder: Path, name: str, only: Collection[str] | None) -> tuple[dict[str, State], dict[str, Any]]:
    """The parts of a checkpoint and its manifest."""
    path = _find(folder, name)
    before = _identity(path)
    try:
        manifest = read_manifest(path)
        if lacking := set(only or ()) - set(manifest["files"]):
            raise damaged(path, f"it lacks {', '.join(sorted(lacking))}")
        arrays, wanted = ArrayFiles(path.parent / _ARRAYS), manifest["files"].keys() if only is None else only
        files = {part: facts for part, facts in manifest["files"].items() if part in wanted}
        return {part: read_state(path / f"{part}.pt", facts, arrays) for part, facts in files.items()}, manifest
    except CheckpointError:
        if _identity(_find(folder, name)) == before:
            raise
    return _load(folder, name, only)  # the run replaced it while it was read


def _remove_unused(folder: Path) -> None:
    """Remove unused array files. If a manifest cannot be read, all stay, because it might use any of them."""
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


def _put_in_place(fresh: Path, target: Path) -> None:
    previous = target.with_name(f".{target.name}.previous")
    if target.exists():
        system.remove_tree(previous, ignore_errors=True)
        system.replace(target, previous)
    system.replace(fresh, target)
    system.sync_folder(target.parent)
    system.remove_tree(previous, ignore_errors=True)


def _find(folder: Path, name: str) -> Path:
    path = below(folder, name)
    for candidate in (path, path.with_name(f".{name}.previous"), path):  # it may be renamed between two attempts
        if os.path.isdir(candidate):
            return candidate
    existing = ", ".join(names(folder)) or "no checkpoints"
    raise CheckpointError(f"there is no checkpoint {name!r}", where=str(folder), hint=f"there are {existing}")


@contextmanager
def fitting(where: str) -> Iterator[None]:
    """Turn the error of a part that cannot load the state of a checkpoint into a CheckpointError."""
    try:
        yield
    except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
        reason = (str(error).splitlines() or [""])[0]
        raise CheckpointError(
            f"its content does not fit the run's spec ({type(error).__name__}: {reason})",
            where=where,
            hint="restore the folder from a copy",
        ) from error


def damaged(path: Path, why: str) -> CheckpointError:
    """The error for a damaged checkpoint."""
    return CheckpointError(
        f"the checkpoint is damaged: {why}", where=str(path), hint="use another checkpoint of the run, or train again"
    )


def read_manifest(path: Path) -> dict[str, Any]:
    """The manifest of the checkpoint in the folder `path`, verified against its own sha256.

    Raises CheckpointError if it is missing, damaged or of a newer format.
    """
    try:
        with (path / _MANIFEST).open("rb") as file:
            manifest = parse_object(file.read(_MANIFEST_BYTES))
    except OSError as error:
        raise damaged(path, f"its {_MANIFEST} is missing ({error.strerror})") from error
    if manifest is None:
        raise damaged(path, f"its {_MANIFEST} cannot be read")
    version = manifest.get("format")
    if isinstance(version, int) and version > FORMAT:
        raise CheckpointError(
            f"the checkpoint has format {version}, this karolos knows {FORMAT}", where=str(path), hint="update karolos"
        )
    files = manifest.get("files")
    valid = (
        manifest.get("sha256") == seal(manifest)
        and isinstance(manifest.get("meta"), dict)
        and isinstance(files, dict)
        and all(PART.fullmatch(part) for part in files)
    )
    if not valid:
        raise damaged(path, f"its {_MANIFEST} was changed")
    return manifest


def seal(manifest: Mapping[str, Any]) -> str:
    """sha256 (hex) of a manifest without its field `sha256`."""
    rest = {key: value for key, value in manifest.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def _write_synced(path: Path, data: bytes | memoryview) -> None:
    """Write a file to the disk. Raises OSError."""
    with path.open("wb") as file:
        file.write(data)
        file.flush()
        system.sync(file.fileno())


def read_state(path: Path, facts: Any, arrays: ArrayFiles) -> State:
    """The state in a file, verified against its size and hash in the manifest.

    Raises CheckpointError if it is missing, truncated, changed, or holds something else than a plain state.
    """
    try:
        data = path.read_bytes()
        if len(data) != facts["bytes"]:
            raise damaged(path, f"it has {len(data):,} bytes of {facts['bytes']:,}")
        if hashlib.sha256(data).hexdigest() != facts["sha256"]:
            raise damaged(path, "its content was changed")
        state = unpack_state(data, arrays)
    except OSError as error:
        raise damaged(path, f"it cannot be read ({error.strerror})") from error
    except ArrayFileError as error:
        raise damaged(path, str(error)) from error
    except (pickle.UnpicklingError, *_MALFORMED) as error:
        raise CheckpointError(
            "the checkpoint does not hold a plain state and was not loaded",
            where=str(path),
            hint="it may run foreign code: do not load it by other means unless you wrote it yourself",
        ) from error
    if not isinstance(state, dict):
        raise damaged(path, "it does not hold a state")
    return state


def pack_state(state: State, path: str = "state", arrays: ArrayFiles | None = None) -> bytes:
    """A state as bytes, for a file or another process. Arguments and errors are those of `encode`."""
    import torch  # noqa: PLC0415

    file = io.BytesIO()
    torch.save(encode(state, path, arrays), file)
    return file.getvalue()


def unpack_state(data: bytes, arrays: ArrayFiles | None = None) -> State:
    """The inverse of `pack_state`."""
    import torch  # noqa: PLC0415

    state: State = decode(torch.load(io.BytesIO(data), map_location="cpu", weights_only=True), arrays)
    return state


def encode(value: Any, path: str = "state", arrays: ArrayFiles | None = None) -> Any:
    """A state as tensors, containers and plain values; large arrays go into `arrays`, if given.

    Raises TypeError if it holds something else; `path` names it.
    """
    import torch  # noqa: PLC0415

    if value is None or type(value) in {bool, str, float}:
        return value
    if type(value) is int:
        return value if value in _WORD else {_TAG: "integer", "text": hex(value)}
    if isinstance(value, torch.Tensor):
        alone = value.detach().cpu()  # torch.save would write the whole storage of a view
        return alone.clone() if alone.untyped_storage().nbytes() > alone.nbytes else alone
    if isinstance(value, np.ndarray | np.generic):
        return _encode_array(value, path, arrays)
    if isinstance(value, Mapping):
        if _TAG in value or not all(type(key) in {str, int} for key in value):
            raise TypeError(f"{path}: keys of a state are strings or integers other than {_TAG}")
        return {key: encode(item, f"{path}.{key}", arrays) for key, item in value.items()}
    if type(value) in {list, tuple}:
        return type(value)(encode(item, f"{path}[{index}]", arrays) for index, item in enumerate(value))
    raise TypeError(f"{path}: a checkpoint cannot hold a {type(value).__name__}")


def decode(value: Any, arrays: ArrayFiles | None = None) -> Any:
    """The inverse of `encode`. Raises ArrayFileError if an array file is missing or damaged."""
    if isinstance(value, dict):
        if _TAG in value:
            return int(value["text"], 16) if value[_TAG] == "integer" else _decode_array(value, arrays)
        return {key: decode(item, arrays) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(decode(item, arrays) for item in value)
    return value


def _encode_array(value: np.ndarray | np.generic, path: str, arrays: ArrayFiles | None) -> dict[str, Any]:
    import torch  # noqa: PLC0415

    array = np.asarray(value)
    if array.dtype.hasobject or array.dtype.fields:
        raise TypeError(f"{path}: a checkpoint cannot hold an array of {array.dtype}")
    data = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
    shape = {"dtype": array.dtype.str, "shape": array.shape}
    if arrays is not None and data.nbytes >= LARGE:
        return {_TAG: "array_files", **shape, "bytes": data.nbytes, "files": arrays.write(data)}
    if not data.flags.writeable:  # torch warns of tensors over read-only memory
        data = data.copy()
    kind = "array" if isinstance(value, np.ndarray) else "scalar"
    return {_TAG: kind, **shape, "data": torch.from_numpy(data)}


def _decode_array(value: dict[str, Any], arrays: ArrayFiles | None) -> Any:
    if value[_TAG] == "array_files":
        if arrays is None:
            raise ValueError("an array is stored in array files, and no folder of them is given")
        data = arrays.read(value["files"], value["bytes"])
    else:
        data = value["data"].numpy()
    array = data.view(np.dtype(value["dtype"])).reshape(value["shape"])
    return array[()] if value[_TAG] == "scalar" else array
