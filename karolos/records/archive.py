"""Run folders as one file, .tar.gz or .zip, to give away and to take in. What comes in is not trusted."""

from __future__ import annotations

import os
import re
import shutil
import tarfile
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, NoReturn

from ..errors import RunError, UsageError
from ..files import sync_folder, writing
from . import RunFolder
from .run_records import ID

SUFFIXES = (".tar.gz", ".tgz", ".zip")
MOST_FILES = 1_000_000
MOST_BYTES = 64 << 30
"""What an archive may unpack to, if its receiver does not say more."""
_DEEPEST = 12
_CHUNK = 1 << 20
_LEFT_OUT = re.compile(r"(?:.*\.)?lock|\..*\.tmp")
"""What belongs to processes, not to the run."""
_PART = re.compile(r"[^\x00-\x1f\x7f/\\:*?\"<>|]{1,255}")
"""A name that every file system can hold."""
_RESERVED = re.compile(r"(?i)(?:con|prn|aux|nul|com\d|lpt\d)(?:\..*)?")


@dataclass(frozen=True)
class Imported:
    """A run that came in, and what is damaged in it, one line each."""

    folder: RunFolder
    problems: tuple[str, ...]


def export_runs(folders: Sequence[RunFolder], target: Path, *, checkpoints: bool = True) -> int:
    """Write run folders into a new archive; returns how many files it holds.

    Args:
        folders: none of which a process is running.
        target: ends in one of SUFFIXES, and is not there yet.
        checkpoints: put them in, which can be large.

    Raises:
        UsageError: the target is there, or of another kind.
        RunError: a process is running one of them.
        MachineError: the disk is full, or the target cannot be written; nothing is left behind.
    """
    _check_suffix(target)
    if target.exists():
        raise UsageError("the file is there already", where=str(target), hint="name another, or remove it")
    beside = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    with writing(target):
        try:
            files = 0
            with _Writer(beside, zipped=target.suffix == ".zip") as writer:
                for folder in folders:
                    with folder:
                        folder.lock()  # so that nobody writes meanwhile
                        for path in _files(folder, checkpoints=checkpoints):
                            writer.add(path, f"{folder.id}/{path.relative_to(folder.path).as_posix()}")
                            files += 1
            os.replace(beside, target)
        finally:
            beside.unlink(missing_ok=True)
    return files


def _files(folder: RunFolder, *, checkpoints: bool) -> Iterator[Path]:
    for place, names, files in os.walk(folder.path):
        names.sort()
        if not checkpoints and Path(place) == folder.path and "checkpoints" in names:
            names.remove("checkpoints")
        for name in sorted(files):
            path = Path(place) / name
            if path.is_file() and not path.is_symlink() and not _LEFT_OUT.fullmatch(name):
                yield path


class _Writer:
    """One way to write both kinds. Files that are links to each other go in as files."""

    def __init__(self, path: Path, *, zipped: bool) -> None:
        self._zip = zipfile.ZipFile(path, "x", zipfile.ZIP_DEFLATED) if zipped else None
        self._tar = None if zipped else tarfile.open(path, "x:gz", compresslevel=6)  # noqa: SIM115

    def __enter__(self) -> _Writer:
        return self

    def __exit__(self, *_: object) -> None:
        for archive in (self._zip, self._tar):
            if archive is not None:
                archive.close()

    def add(self, path: Path, name: str) -> None:
        if self._zip is not None:
            self._zip.write(path, name)
        elif self._tar is not None:
            entry = tarfile.TarInfo(name)
            with path.open("rb") as file:
                status = os.fstat(file.fileno())
                entry.size, entry.mtime = status.st_size, int(status.st_mtime)
                self._tar.addfile(entry, file)


def import_runs(
    source: Path, runs: Path, *, most_bytes: int = MOST_BYTES, known: Callable[[str], bool] | None = None
) -> tuple[Imported, ...]:
    """Unpack an archive's runs into a runs folder: all of them, or none.

    Args:
        source: from `export_runs`, or made by hand: a folder per run, named by its id.
        runs: the runs folder; made if it is not there.
        most_bytes: what it may unpack to.
        known: whether a run of that id is there, besides those in the runs folder.

    Raises:
        UsageError: it is no such archive, is damaged or too large, holds what no run folder does, or a run is here.
        MachineError: the disk is full, or the runs folder cannot be written.
    """
    _check_suffix(source)
    with writing(runs):
        runs.mkdir(parents=True, exist_ok=True)
        place = Path(tempfile.mkdtemp(prefix=".import-", dir=runs))
    try:
        names = _unpack(source, place, most_bytes)
        if not names:
            raise UsageError("there is no run in it", where=str(source), hint="`karolos runs export` makes archives")
        problems = [_examine(place / name, source) for name in names]
        for name in names:
            if (runs / name).exists() or (known is not None and known(name)):
                _refuse(source, f"the run {name} is here already", "`karolos runs rm` throws that one away")
        for name in names:
            with writing(runs / name):
                os.rename(place / name, runs / name)
        sync_folder(runs)
    finally:
        shutil.rmtree(place, ignore_errors=True)
    return tuple(Imported(RunFolder.open(runs / name), found) for name, found in zip(names, problems, strict=True))


def _examine(path: Path, source: Path) -> tuple[str, ...]:
    """What is damaged in a run folder that still can be read."""
    try:
        folder = RunFolder.open(path)
    except RunError as error:
        _refuse(source, f"{path.name}: {error.what}", "export it anew")
    if folder.id != path.name:
        _refuse(source, f"the folder {path.name} says that it is the run {folder.id}", "name it by its run")
    return folder.record().problems


def _unpack(source: Path, place: Path, most_bytes: int) -> list[str]:
    """Write the files below `place`; returns the names of the folders in it."""
    left, seen, tops = most_bytes, set[str](), dict[str, None]()
    for name, file in _members(source):
        parts = _parts(source, name)
        if name.casefold() in seen:
            _refuse(source, f"{name!r} is in it twice", "names that differ in case only are the same to some systems")
        seen.add(name.casefold())
        if len(seen) > MOST_FILES:
            _refuse(source, f"it holds more than {MOST_FILES:,} files", "export fewer runs at a time")
        tops[parts[0]] = None
        target = place.joinpath(*parts)
        with writing(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            with target.open("xb") as copy:
                # Sizes that the archive tells are not believed: what comes out is counted.
                while chunk := _read(source, file):
                    left -= len(chunk)
                    if left < 0:
                        _refuse(source, f"it unpacks to more than {most_bytes:,} bytes", "say how much it may be")
                    copy.write(chunk)
    return list(tops)


def _members(source: Path) -> Iterator[tuple[str, IO[bytes]]]:
    """Files of an archive, one open at a time; folders are passed over and anything else is refused."""
    with _damage_told(source):
        if source.suffix == ".zip":
            with zipfile.ZipFile(source) as archive:
                for item in archive.infolist():
                    mode = item.external_attr >> 16
                    if mode and mode & 0o170000 not in {0, 0o100000, 0o040000}:
                        _refuse(source, f"{item.filename!r} is a link or device", "run folders hold plain files only")
                    if item.flag_bits & 1:
                        _refuse(source, f"{item.filename!r} is encrypted", "unpack it, and pack it without a password")
                    if not item.is_dir():
                        with archive.open(item) as file:
                            yield item.filename, file
            return
        with tarfile.open(source, "r:gz") as tar:
            for member in tar:
                if not member.isreg() and not member.isdir():
                    _refuse(source, f"{member.name!r} is a link or device", "run folders hold plain files only")
                content = tar.extractfile(member) if member.isreg() else None
                if content is not None:
                    yield member.name, content


def _read(source: Path, file: IO[bytes]) -> bytes:
    with _damage_told(source):
        return file.read(_CHUNK)


@contextmanager
def _damage_told(source: Path) -> Iterator[None]:
    try:
        yield
    except FileNotFoundError as error:
        raise UsageError("there is no such file", where=str(source)) from error
    except (tarfile.TarError, zipfile.BadZipFile, zlib.error, EOFError, OSError, NotImplementedError) as error:
        raise UsageError(
            f"the archive cannot be read ({error})", where=str(source), hint="was it copied whole? Export it anew"
        ) from error


def _parts(source: Path, name: str) -> tuple[str, ...]:
    """The way below the runs folder that a name means, which must lead into a run's folder and nowhere else."""
    parts = tuple(name.split("/"))
    odd = [part for part in parts if not _PART.fullmatch(part) or part in {".", ".."} or _RESERVED.fullmatch(part)]
    if odd or parts[0].endswith((" ", ".")):
        _refuse(source, f"{name!r} is no name for a file in a run folder", "plain names below a folder per run")
    if not ID.fullmatch(parts[0]) or not 2 <= len(parts) <= _DEEPEST:
        _refuse(source, f"{name!r} lies in no run folder", "an archive holds a folder per run, named by its id")
    return parts


def _refuse(source: Path, what: str, hint: str) -> NoReturn:
    raise UsageError(what, where=str(source), hint=hint)


def _check_suffix(path: Path) -> None:
    if not path.name.endswith(SUFFIXES):
        raise UsageError("archives end in .tar.gz or .zip", where=str(path), hint="name it so")
