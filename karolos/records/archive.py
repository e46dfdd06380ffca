"""Archives of run folders (.tar.gz): export and import. An imported archive is not trusted."""

from __future__ import annotations

import os
import re
import shutil
import tarfile
import tempfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from gzip import BadGzipFile
from pathlib import Path
from typing import NoReturn

from ..errors import RunError, UsageError
from ..files import FileLock, remove_leftovers, sync_folder, writing
from . import RunFolder
from .run_records import ID, RunRecord

SUFFIX = ".tar.gz"
MOST_FILES = 1_000_000
MOST_BYTES = 64 << 30
"""Default limit of an archive's unpacked size."""
UNFINISHED_IMPORT = ".import-"
"""Beginning of the names of folders in which archives are unpacked."""
_DEEPEST = 12
_LEFT_OUT = re.compile(r"(?:.*\.)?lock|\..*\.tmp")
"""Files of processes, which do not belong to the run."""
_PART = re.compile(r"(?!\.{1,2}$)[^\x00-\x1f\x7f/\\]{1,255}")
"""A name of a file or folder that does not lead elsewhere."""


def export_runs(folders: Sequence[RunFolder], target: Path, *, checkpoints: bool = True) -> int:
    """Write run folders into a new archive; returns the number of files in it.

    Args:
        folders: none of which a process is running.
        target: ends in SUFFIX and does not exist.
        checkpoints: include them, which can be large.

    Raises:
        UsageError: the target exists, or has another suffix.
        RunError: a process is running one of them.
        MachineError: the disk is full, or the target cannot be written; nothing is left behind.
    """
    _check_suffix(target)
    if target.exists():
        raise UsageError("the file exists already", where=str(target), hint="name another, or remove it")
    remove_leftovers(target.parent, rf"\.{re.escape(target.name)}\.(\d+)\.tmp")
    beside = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    with writing(target):
        try:
            files = 0
            with tarfile.open(beside, "x:gz", compresslevel=6) as archive:
                for folder in folders:
                    with folder:
                        folder.lock()  # no process writes meanwhile
                        for path in _files(folder, checkpoints=checkpoints):
                            _add(archive, path, f"{folder.id}/{path.relative_to(folder.path).as_posix()}")
                            files += 1
            os.replace(beside, target)
        finally:
            beside.unlink(missing_ok=True)
    return files


def _add(archive: tarfile.TarFile, path: Path, name: str) -> None:
    # TarFile.add would store hard links as links, and the names of users.
    entry = tarfile.TarInfo(name)
    with path.open("rb") as file:
        status = os.fstat(file.fileno())
        entry.size, entry.mtime = status.st_size, int(status.st_mtime)
        archive.addfile(entry, file)


def _files(folder: RunFolder, *, checkpoints: bool) -> Iterator[Path]:
    for path in sorted(folder.path.rglob("*")):
        if not checkpoints and folder.checkpoints in path.parents:
            continue
        if path.is_file() and not path.is_symlink() and not _LEFT_OUT.fullmatch(path.name):
            yield path


def import_runs(
    source: Path,
    runs: Path,
    *,
    most_bytes: int = MOST_BYTES,
    enter: Callable[[Sequence[RunRecord]], None] | None = None,
) -> tuple[RunRecord, ...]:
    """Unpack an archive's runs into a runs folder: all of them, or none.

    Args:
        source: from `export_runs`, or made by hand: a folder per run, named by its id.
        runs: the runs folder; created if it does not exist.
        most_bytes: limit of the unpacked size.
        enter: enters the runs into the index. After an error of it their folders are removed again.

    Returns:
        The runs, with one line per damaged file.

    Raises:
        UsageError: it is not such an archive, is damaged or too large, holds other files than those of run folders, or
            one of its runs exists.
        MachineError: the disk is full, or the runs folder cannot be written.
    """
    _check_suffix(source)
    remove_unfinished_imports(runs)
    with writing(runs):
        runs.mkdir(parents=True, exist_ok=True)
        place = Path(tempfile.mkdtemp(prefix=UNFINISHED_IMPORT, dir=runs))
    lock = FileLock(place / ".lock")
    moved: list[str] = []
    try:
        lock.acquire()
        names = _unpack(source, place, most_bytes)
        for name in names:
            _examine(place / name, source)
            if (runs / name).exists():
                _refuse(source, f"the run {name} exists already", "`karolos runs rm` removes it")
        for name in names:
            with writing(runs / name):
                os.rename(place / name, runs / name)
            moved.append(name)
        with writing(runs):
            sync_folder(runs)
        records = tuple(RunFolder.open(runs / name).record() for name in names)
        if enter is not None:
            enter(records)
    except BaseException:
        for name in moved:
            os.rename(runs / name, place / name)
        raise
    finally:
        lock.release()
        shutil.rmtree(place, ignore_errors=True)
    return records


def remove_unfinished_imports(runs: Path) -> None:
    """Remove what killed imports into this runs folder have unpacked."""
    for place in runs.glob(f"{UNFINISHED_IMPORT}*"):
        lock = FileLock(place / ".lock")
        if lock.path.exists() and not lock.is_locked():
            shutil.rmtree(place, ignore_errors=True)


def _examine(path: Path, source: Path) -> None:
    """Refuse a folder that is not that of the run whose name it has."""
    try:
        folder = RunFolder.open(path)
    except RunError as error:
        _refuse(source, f"{path.name}: {error.what}", "export it again")
    if folder.id != path.name:
        _refuse(source, f"the folder {path.name} says that it is the run {folder.id}", "name it by its run")


def _unpack(source: Path, place: Path, most_bytes: int) -> list[str]:
    """Write the files of an archive below `place`; returns the names of the folders in it."""
    members = _Members(source, most_bytes)
    try:
        file = source.open("rb")
    except OSError as error:
        raise UsageError(f"the archive cannot be opened ({error.strerror})", where=str(source)) from error
    with file, writing(place):
        try:
            with tarfile.open(fileobj=file, mode="r:gz") as tar:
                tar.extractall(place, filter=members.check)
        except (BadGzipFile, EOFError, OverflowError, ValueError, tarfile.TarError, zlib.error) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            _refuse(source, f"the archive cannot be read ({reason})", "was it copied completely? Export it again")
    if not members.folders:
        _refuse(source, "there is no run in it", "`karolos runs export` makes archives")
    return list(members.folders)


class _Members:
    """Checks the members of an archive one after the other: plain files in run folders, not too many or too large.

    The sizes are those that the archive declares; tarfile never unpacks more than that.
    """

    def __init__(self, source: Path, most_bytes: int) -> None:
        self._source = source
        self._most_bytes = self._bytes_left = most_bytes
        self._names: set[str] = set()
        self.folders: dict[str, None] = {}
        """Names of the run folders, in order."""

    def check(self, member: tarfile.TarInfo, place: str) -> tarfile.TarInfo | None:
        """The member as tarfile's data filter leaves it; None for a folder, which is made with its files."""
        if member.isdir():
            return None
        source, name, parts = self._source, member.name, member.name.split("/")
        if not member.isreg():
            _refuse(source, f"{name!r} is a link or device", "run folders hold plain files only")
        if not all(_PART.fullmatch(part) for part in parts):
            _refuse(source, f"{name!r} is not a valid name in a run folder", "plain names below a folder per run")
        if not ID.fullmatch(parts[0]) or not 2 <= len(parts) <= _DEEPEST:
            _refuse(source, f"{name!r} is not in a run folder", "an archive holds a folder per run, named by its id")
        if name.casefold() in self._names:
            _refuse(source, f"{name!r} is in it twice", "some systems do not distinguish upper and lower case")
        self._names.add(name.casefold())
        if len(self._names) > MOST_FILES:
            _refuse(source, f"it holds more than {MOST_FILES:,} files", "export fewer runs at a time")
        self._bytes_left -= member.size
        if self._bytes_left < 0:
            _refuse(source, f"it unpacks to more than {self._most_bytes:,} bytes", "--most raises the limit")
        self.folders[parts[0]] = None
        return tarfile.data_filter(member, place)


def _refuse(source: Path, what: str, hint: str) -> NoReturn:
    raise UsageError(what, where=str(source), hint=hint)


def _check_suffix(path: Path) -> None:
    if not path.name.endswith(SUFFIX):
        _refuse(path, f"archives end in {SUFFIX}", "name it so")
