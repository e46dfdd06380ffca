"""The trash: `.trash` in the runs folder holds removed run folders until they are purged."""

from __future__ import annotations

from pathlib import Path

from .. import system
from ..errors import RunError, UsageError
from ..system.files import writing
from . import RunFolder, paths

NAME = ".trash"


def throw_away(folder: RunFolder) -> Path:
    """Move a run folder into the trash; returns its new path.

    Raises RunError if a process is running it. After a MachineError it is in its old place.
    """
    trash = folder.path.parent / NAME
    with folder:
        folder.lock()
        with writing(trash):
            trash.mkdir(exist_ok=True)
            target = _free(trash, folder.path.name)
            if system.WINDOWS:  # there a folder can move only if none of its files is open
                folder.release()
            system.replace(folder.path, target)
            system.sync_folder(trash)
            system.sync_folder(trash.parent)
    return target


def thrown_away(runs: str | Path) -> list[Path]:
    """The run folders in the trash of a runs folder, by name."""
    return paths(Path(runs) / NAME)


def find(runs: str | Path, selector: str) -> Path:
    """The one folder in the trash whose name is or begins with the selector.

    Raises UsageError if there is none, or several.
    """
    trashed = thrown_away(runs)
    exact = [path for path in trashed if path.name == selector]
    found = exact or [path for path in trashed if selector and path.name.startswith(selector)]
    if len(found) != 1:
        what = f"{selector!r} means {'several runs' if found else 'no run'} in the trash"
        raise UsageError(what, hint="`karolos runs list --trash` shows them")
    return found[0]


def restore(path: Path) -> RunFolder:
    """Move a folder out of the trash, under its run's id.

    Raises UsageError if a folder of that name exists, RunError if it is damaged, MachineError if it cannot be moved.
    """
    folder = RunFolder.open(path)
    target = path.parent.parent / folder.id
    if target.exists():
        raise UsageError(
            f"there is a run {folder.id} again", where=str(target), hint="`karolos runs rm` removes that one"
        )
    with writing(target):
        system.replace(path, target)
        system.sync_folder(target.parent)
    return RunFolder.open(target)


def purge(path: Path) -> None:
    """Delete a folder in the trash. Raises RunError if it is elsewhere, MachineError if it cannot be deleted."""
    if path.parent.name != NAME or path.parent.is_symlink() or path.is_symlink():
        raise RunError("this is not in the trash", where=str(path), hint="`karolos runs rm RUN` moves it there")
    with writing(path):
        system.remove_tree(path)


def _free(trash: Path, name: str) -> Path:
    """An unused path in the trash: a run may be removed, imported and removed again."""
    number, path = 1, trash / name
    while path.exists():
        number += 1
        path = trash / f"{name}-{number}"
    return path
