"""The manifest of a checkpoint: format, meta, size and sha256 of each file, array files, sha256 of itself."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..errors import RunError
from ..files import parse_object, write_json

FORMAT = 1
"""Version of the encoding and of the manifest."""
PART = re.compile(r"[a-z][a-z0-9_]{0,31}")
"""Names of checkpoints and of their parts."""
_MANIFEST = "manifest.json"
_MANIFEST_BYTES = 1 << 24


class CheckpointError(RunError):
    """A checkpoint that is missing, damaged, from a newer karolos or unsafe to load."""


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

    Raises:
        CheckpointError: it is missing, damaged or of a newer format.
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


def write_manifest(path: Path, content: Mapping[str, Any]) -> None:
    """Write the manifest of the checkpoint in the folder `path` to the disk. Raises MachineError."""
    manifest: dict[str, Any] = {"format": FORMAT, **content}
    write_json(path / _MANIFEST, manifest | {"sha256": seal(manifest)})


def seal(manifest: Mapping[str, Any]) -> str:
    """sha256 (hex) of a manifest without its field `sha256`."""
    rest = {key: value for key, value in manifest.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()
