"""Archives of run folders, .tar.gz or .zip: export and import. An imported archive is not trusted."""

from __future__ import annotations

import lzma
import os
import re
import shutil
import struct
import tarfile
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from gzip import BadGzipFile
from pathlib import Path
from typing import NoReturn

from ..errors import RunError, UsageError
from ..files import FileLock, remove_leftovers, sync_folder, writing
from . import RunFolder
from .run_records import ID
from .storable import run_fault

SUFFIXES = (".tar.gz", ".tgz", ".zip")
MOST_FILES = 1_000_000
MOST_BYTES = 64 << 30
"""Default limit of an archive's unpacked size."""
UNFINISHED_IMPORT = ".import-"
"""Beginning of the names of folders in which archives are unpacked."""
_DEEPEST = 12
_LEFT_OUT = re.compile(r"(?:.*\.)?lock|\..*\.tmp")
"""Files of processes, which do not belong to the run."""
_PART = re.compile(r"[^\x00-\x1f\x7f/\\:*?\"<>|]{1,255}")
"""A name that every file system can hold."""
_DAMAGE = (
    *(tarfile.TarError, zipfile.BadZipFile, BadGzipFile, zlib.error, lzma.LZMAError, struct.error),
    *(EOFError, OSError, OverflowError, RuntimeError, ValueError),
)
"""What tarfile, zipfile and the decompressors raise for damaged data."""
_RESERVED = re.compile(r"(?i)(?:con|prn|aux|nul|com\d|lpt\d)(?:\..*)?")


@dataclass(frozen=True)
class Imported:
    """An imported run, and one line per damaged file in it."""

    folder: RunFolder
    problems: tuple[str, ...]


def export_runs(folders: Sequence[RunFolder], target: Path, *, checkpoints: bool = True) -> int:
    """Write run folders into a new archive; returns the number of files in it.

    Args:
        folders: none of which a process is running.
        target: ends in one of SUFFIXES and does not exist.
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
            with _create(beside, zipped=target.suffix == ".zip") as archive:
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


def _create(path: Path, *, zipped: bool) -> zipfile.ZipFile | tarfile.TarFile:
    return zipfile.ZipFile(path, "x", zipfile.ZIP_DEFLATED) if zipped else tarfile.open(path, "x:gz", compresslevel=6)


def _add(archive: zipfile.ZipFile | tarfile.TarFile, path: Path, name: str) -> None:
    if isinstance(archive, zipfile.ZipFile):
        archive.write(path, name)
        return
    # TarFile.add would store hard links as links, and the names of users.
    entry = tarfile.TarInfo(name)
    with path.open("rb") as file:
        status = os.fstat(file.fileno())
        entry.size, entry.mtime = status.st_size, int(status.st_mtime)
        archive.addfile(entry, file)


def _files(folder: RunFolder, *, checkpoints: bool) -> Iterator[Path]:
    for place, names, files in os.walk(folder.path):
        names.sort()
        if not checkpoints and Path(place) == folder.path and "checkpoints" in names:
            names.remove("checkpoints")
        for name in sorted(files):
            path = Path(place) / name
            if path.is_file() and not path.is_symlink() and not _LEFT_OUT.fullmatch(name):
                yield path


def import_runs(
    source: Path, runs: Path, *, most_bytes: int = MOST_BYTES, known: Callable[[str], bool] | None = None
) -> tuple[Imported, ...]:
    """Unpack an archive's runs into a runs folder: all of them, or none.

    Args:
        source: from `export_runs`, or made by hand: a folder per run, named by its id.
        runs: the runs folder; created if it does not exist.
        most_bytes: limit of the unpacked size.
        known: whether a run of that id exists outside the runs folder.

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
    try:
        lock.acquire()
        names = _unpack(source, place, most_bytes)
        if not names:
            raise UsageError("there is no run in it", where=str(source), hint="`karolos runs export` makes archives")
        problems = [_examine(place / name, source) for name in names]
        for name in names:
            if (runs / name).exists() or (known is not None and known(name)):
                _refuse(source, f"the run {name} exists already", "`karolos runs rm` removes it")
        _move(names, place, runs)
    finally:
        lock.release()
        shutil.rmtree(place, ignore_errors=True)
    return tuple(Imported(RunFolder.open(runs / name), found) for name, found in zip(names, problems, strict=True))


def remove_unfinished_imports(runs: Path) -> None:
    """Remove what killed imports into this runs folder have unpacked."""
    for place in runs.glob(f"{UNFINISHED_IMPORT}*"):
        lock = FileLock(place / ".lock")
        if lock.path.exists() and not lock.is_locked():
            shutil.rmtree(place, ignore_errors=True)


def _move(names: Sequence[str], place: Path, runs: Path) -> None:
    """Move the folders into the runs folder: all, or none after an error."""
    moved: list[str] = []
    try:
        for name in names:
            with writing(runs / name):
                os.rename(place / name, runs / name)
            moved.append(name)
        with writing(runs):
            sync_folder(runs)
    except BaseException:
        for name in moved:
            os.rename(runs / name, place / name)
        raise


def _examine(path: Path, source: Path) -> tuple[str, ...]:
    """One line per damaged file of a run folder that can still be read."""
    try:
        folder = RunFolder.open(path)
    except RunError as error:
        _refuse(source, f"{path.name}: {error.what}", "export it again")
    if folder.id != path.name:
        _refuse(source, f"the folder {path.name} says that it is the run {folder.id}", "name it by its run")
    record = folder.record()
    if fault := run_fault(record):
        _refuse(source, f"{path.name}: {fault}", "its files were damaged or edited: export it again")
    return record.problems


def _unpack(source: Path, place: Path, most_bytes: int) -> list[str]:
    """Write the files of an archive below `place`; returns the names of the folders in it."""
    members = _Members(source, most_bytes)
    try:
        file = source.open("rb")
    except OSError as error:
        raise UsageError(f"the archive cannot be opened ({error.strerror})", where=str(source)) from error
    with file, writing(place):
        try:
            if source.suffix == ".zip":
                with zipfile.ZipFile(file) as archive:
                    for item in archive.infolist():
                        if not item.is_dir():
                            members.check_zip(item)
                            archive.extract(item, place)
            else:
                with tarfile.open(fileobj=file, mode="r:gz") as tar:
                    tar.extractall(place, filter=members.filter_tar)
        except _DAMAGE as error:
            if isinstance(error, OSError) and error.errno is not None and not isinstance(error, BadGzipFile):
                raise  # of the disk; errors of decompression have no number
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            _refuse(source, f"the archive cannot be read ({reason})", "was it copied completely? Export it again")
    return list(members.folders)


class _Members:
    """Checks the members of an archive one after the other: plain files in run folders, not too many or too large.

    The sizes are those that the archive declares; tarfile and zipfile never unpack more than that.
    """

    def __init__(self, source: Path, most_bytes: int) -> None:
        self._source = source
        self._most_bytes = self._bytes_left = most_bytes
        self._names: set[str] = set()
        self.folders: dict[str, None] = {}
        """Names of the run folders, in order."""

    def filter_tar(self, member: tarfile.TarInfo, place: str) -> tarfile.TarInfo | None:
        """The member as tarfile's data filter leaves it; None for a folder, which is made with its files."""
        if member.isdir():
            return None
        self._check(member.name, member.size, plain=member.isreg())
        return tarfile.data_filter(member, place)

    def check_zip(self, item: zipfile.ZipInfo) -> None:
        if item.flag_bits & 1:
            _refuse(self._source, f"{item.filename!r} is encrypted", "pack it again without a password")
        kind = (item.external_attr >> 16) & 0o170000
        self._check(item.filename, item.file_size, plain=kind in {0, 0o100000})

    def _check(self, name: str, size: int, *, plain: bool) -> None:
        source, parts = self._source, name.split("/")
        if not plain:
            _refuse(source, f"{name!r} is a link or device", "run folders hold plain files only")
        invalid = any(
            not _PART.fullmatch(part) or part in {".", ".."} or _RESERVED.fullmatch(part) for part in parts
        ) or parts[0].endswith((" ", "."))
        if invalid:
            _refuse(source, f"{name!r} is not a valid name in a run folder", "plain names below a folder per run")
        if not ID.fullmatch(parts[0]) or not 2 <= len(parts) <= _DEEPEST:
            _refuse(source, f"{name!r} is not in a run folder", "an archive holds a folder per run, named by its id")
        if name.casefold() in self._names:
            _refuse(source, f"{name!r} is in it twice", "some systems do not distinguish upper and lower case")
        self._names.add(name.casefold())
        if len(self._names) > MOST_FILES:
            _refuse(source, f"it holds more than {MOST_FILES:,} files", "export fewer runs at a time")
        self._bytes_left -= size
        if self._bytes_left < 0:
            _refuse(source, f"it unpacks to more than {self._most_bytes:,} bytes", "--most raises the limit")
        self.folders[parts[0]] = None


def _refuse(source: Path, what: str, hint: str) -> NoReturn:
    raise UsageError(what, where=str(source), hint=hint)


def _check_suffix(path: Path) -> None:
    if not path.name.endswith(SUFFIXES):
        _refuse(path, "archives end in .tar.gz or .zip", "name it so")
