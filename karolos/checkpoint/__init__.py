"""Checkpoints: a folder of files that is whole or not there, and says so when it is damaged.

    <name>/<part>.pt        one file per part, written by torch.save, read with weights_only=True and nothing else
    <name>/manifest.json    format, meta, size and sha256 of each file, blocks, sha256 of itself; written last
    .blocks/                large arrays in pieces, which checkpoints share (`karolos.checkpoint.array_files`)

A checkpoint is written beside the old one and takes its place by renaming. Killed between the two renames, the old one
still lies in `.<name>.previous`, where `load` finds it.
"""

from .errors import CheckpointError
from .folder import digest, load, names, read_meta, rename, save

__all__ = ["CheckpointError", "digest", "load", "names", "read_meta", "rename", "save"]
