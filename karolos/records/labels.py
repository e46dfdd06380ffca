"""Labels: the tags and the note that people give a run, in labels.json of the run folder.

They can be written during a run. Afterwards the index reads this file again (`Store.refresh_labels`). If two processes
write at the same time, no change is lost.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from ..errors import RunError, UsageError
from ..system.files import locked, write_json
from .decode import read_json

LONGEST_TAG, LONGEST_NOTE = 200, 100_000
"""Largest length in characters."""
_TAG = re.compile(rf"(?!\s)[^\n\r\0\ud800-\udfff]{{1,{LONGEST_TAG}}}(?<!\s)")
_NOTE = re.compile(rf"[^\0\ud800-\udfff]{{0,{LONGEST_NOTE}}}")
"""Texts that every database and file can hold: without NUL and surrogates."""
_FILE = "labels.json"


@dataclass(frozen=True)
class Labels:
    """Tags in alphabetical order, and a note."""

    tags: tuple[str, ...] = ()
    note: str | None = None


def read(folder: Path) -> Labels:
    """The labels of a run folder; empty if there are none or the file is damaged."""
    return read_json(Labels, folder / _FILE) or Labels()


def is_damaged(folder: Path) -> bool:
    """Whether the file of labels exists and cannot be read."""
    return os.path.exists(folder / _FILE) and read_json(Labels, folder / _FILE) is None


def add_tags(folder: Path, tags: Iterable[str]) -> bool:
    """Add tags to a run; returns whether its labels changed.

    Raises UsageError if a text cannot be a tag, RunError if labels.json is damaged.
    """
    new = set(tags)
    for tag in new:
        if not _TAG.fullmatch(tag):
            raise UsageError(
                f"{tag[:LONGEST_TAG]!r}{'...' * (len(tag) > LONGEST_TAG)} is not a tag",
                hint=f"1 to {LONGEST_TAG} characters on one line, without blanks around them",
            )
    return _change(folder, lambda old: Labels(tuple(sorted({*old.tags, *new})), old.note))


def remove_tags(folder: Path, tags: Iterable[str]) -> bool:
    """Remove tags; those that the run does not have are ignored. Returns and raises as `add_tags` does."""
    gone = set(tags)
    return _change(folder, lambda old: Labels(tuple(tag for tag in old.tags if tag not in gone), old.note))


def set_note(folder: Path, note: str) -> bool:
    """Replace the note; an empty text removes it. Returns whether the labels changed.

    Raises UsageError if it is too long, RunError if labels.json is damaged.
    """
    if not _NOTE.fullmatch(note):
        raise UsageError(f"the note has {len(note):,} characters", hint=f"up to {LONGEST_NOTE:,} can be stored")
    return _change(folder, lambda old: Labels(old.tags, note or None))


def _change(folder: Path, change: Callable[[Labels], Labels]) -> bool:
    """Replace the labels, one process after the other."""
    with locked(folder / "labels.lock"):
        if is_damaged(folder):
            raise RunError(f"{_FILE} is damaged", where=str(folder), hint="repair it, or move it away")
        old = read(folder)
        new = change(old)
        write_json(folder / _FILE, asdict(new))
    return new != old
