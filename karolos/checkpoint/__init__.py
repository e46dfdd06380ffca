"""Checkpoints: folders that are complete or missing, and detect damage.

    <name>/<part>.pt        one file per part, written by torch.save, read with weights_only=True and nothing else
    <name>/manifest.json    format, meta, size and sha256 of each file, array files, sha256 of itself; written last
    .arrays/                large arrays in files that checkpoints share (`karolos.checkpoint.array_files`)

A checkpoint is written beside the old one and takes its place by renaming. If the process is killed between the two
renames, `load` finds the old one in `.<name>.previous`.
"""

from .folder import digest, load, load_part, names, read_meta, rename, save
from .manifest import CheckpointError, fitting
from .state_file import pack_state, unpack_state

__all__ = [
    "CheckpointError",
    "digest",
    "fitting",
    "load",
    "load_part",
    "names",
    "pack_state",
    "read_meta",
    "rename",
    "save",
    "unpack_state",
]
