"""Archives of run folders (.tar.gz): export and import. An imported archive is not trusted.

An archive holds only the files of runs, with *** in place of secrets. Its last member, SHA256SUMS, lists them as
`sha256sum` does.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import os
import re
import shutil
import tarfile
import tempfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from typing_extensions import override

from .. import system
from ..errors import RunError, UsageError, recorded, redact, without_folders
from ..system.files import FileLock, parse_object, remove_leftovers, writing
from . import RunFolder
from .checkpoint import PART
from .run_records import ID, RunRecord

SUFFIX = ".tar.gz"
SUMS = "SHA256SUMS"
_GZIP = b"\x1f\x8b"
"""Beginning of every gzipped file."""
_MOST_LISTED = 1 << 28
"""Largest size of the list in bytes."""
_MOST_AT_ONCE = 1 << 20
"""Bytes that are read at once. Only a larger header needs more, because tarfile reads headers whole."""
MOST_FILES = 1_000_000
MOST_BYTES = 64 << 30
"""Default limit of an archive's unpacked size."""
UNFINISHED_IMPORT = ".import-"
"""Beginning of the names of folders in which archives are unpacked."""
_AGAIN = "was it copied completely? Export it again"
_FILE = re.compile(
    r"spec\.yaml|code\.diff|play(?:-failures)?\.mp4"
    r"|(?:run|resolved|state|labels)\.json|(?:tests|final|events|episodes|transfers)\.jsonl"
    r"|tensorboard/(?:film/)?events\.out\.tfevents\.[0-9A-Za-z._-]{1,100}"
    r"|export/(?:policy\.(?:npz|json|onnx)|golden\.npz)"
    rf"|checkpoints/(?:{PART.pattern}|\.{PART.pattern}\.previous)/(?:{PART.pattern}\.pt|manifest\.json)"
    r"|checkpoints/\.arrays/[0-9a-f]{64}"
    r"|robot/(?:[0-9A-Za-z_-][0-9A-Za-z._-]{0,99}/){0,12}[0-9A-Za-z_-][0-9A-Za-z._-]{0,99}"
)
"""A file that a run has, by its path below the run's folder."""
_OF_PROCESSES = re.compile(r"(?:.*\.)?lock|\..*\.tmp|launch\.json|progress\.json|stop|slurm\.job")
"""Names of files for communication between processes. They are left out without a message."""
_TOLD = re.compile(r"(?:run|resolved|state)\.json|(?:events|transfers)\.jsonl")
"""Files with messages, in JSON."""
_MEMBER = re.compile(rf"({ID.pattern})/(?:{_FILE.pattern})")


class ExportedRuns(NamedTuple):
    """Content of an archive."""

    files: int
    left_out: tuple[str, ...]
    """Foreign files in the run folders, as run/path."""


def export_runs(
    folders: Sequence[RunFolder], target: Path, *, checkpoints: bool = True, source: bool = True
) -> ExportedRuns:
    """Write run folders into a new archive, whose name ends in SUFFIX. After an error nothing is left behind.

    Without `checkpoints`, which can be large, these are left out. Without `source` also code.diff, commands, names of
    untracked files, tracebacks and the folders of absolute paths.

    Raises UsageError if the target exists or has another suffix, RunError if a process is running one of the runs,
    MachineError if the disk is full or the target cannot be written.
    """
    if not target.name.endswith(SUFFIX):
        raise _refused(target, f"archives end in {SUFFIX}", "name it so")
    if target.exists():
        raise UsageError("the file exists already", where=str(target), hint="name another, or remove it")
    remove_leftovers(target.parent, rf"\.{re.escape(target.name)}\.(\d+)\.tmp")
    fresh = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    sums: dict[str, str] = {}
    left_out: list[str] = []
    with writing(target):
        try:
            with tarfile.open(fresh, "x:gz", compresslevel=6) as archive:
                for folder in folders:
                    with folder:
                        folder.lock()  # no process writes meanwhile
                        for name in _files(folder):
                            if not _FILE.fullmatch(name):
                                left_out.append(f"{folder.id}/{name}")
                            elif checkpoints or not name.startswith("checkpoints/"):
                                if (data := _shared(folder, name, source)) is None:
                                    continue
                                sums[f"{folder.id}/{name}"] = hashlib.sha256(data).hexdigest()
                                _add(archive, f"{folder.id}/{name}", data)
                _add(archive, SUMS, "".join(f"{sha256}  {name}\n" for name, sha256 in sums.items()).encode())
            system.replace(fresh, target)
        finally:
            system.remove(fresh, missing_ok=True)
    return ExportedRuns(len(sums), tuple(left_out))


def _shared(folder: RunFolder, name: str, source: bool) -> bytes | None:
    """The content of a file for an archive; None to leave it out."""
    data = (folder.path / name).read_bytes()
    if name in ("code.diff", "spec.yaml"):
        text = redact(data.decode(errors="replace"))
        return text.encode() if source else None if name == "code.diff" else without_folders(text).encode()
    if not _TOLD.fullmatch(name):
        return data
    lines = data.splitlines(keepends=True) if name.endswith("l") else [data]
    return b"".join(_told(folder, name, line, source) for line in lines)


def _told(folder: RunFolder, name: str, line: bytes, source: bool) -> bytes:
    """A JSON object in the form of an archive. An invalid line stays as it is."""
    if (old := parse_object(line)) is None:
        return line
    new = recorded(old, folders=source)
    if not source:
        new = {key: one for key, one in new.items() if key not in ("command", "traceback", "unread")}
        new |= {"git": new["git"] | {"untracked": []}} if new.get("git") else {}
    if name == "run.json" and "resolved_sha256" in new:
        resolved = _shared(folder, "resolved.json", source) if (folder.path / "resolved.json").exists() else None
        if resolved is not None and folder.read_spec() is not None:  # a damaged one stays so
            new["resolved_sha256"] = hashlib.sha256(resolved).hexdigest()
    return line if new == old else json.dumps(new, indent=None if name.endswith("l") else 2).encode() + b"\n"


def _add(archive: tarfile.TarFile, name: str, data: bytes) -> None:
    entry = tarfile.TarInfo(name)  # without links, times and the names of users
    entry.size = len(data)
    archive.addfile(entry, io.BytesIO(data))


def _files(folder: RunFolder) -> Iterator[str]:
    """The paths of files below a run's folder; without those of processes."""
    for path in sorted(folder.path.rglob("*")):
        name = path.relative_to(folder.path).as_posix()
        if path.is_symlink():
            yield f"{name} (a link)"
        elif path.is_file() and not _OF_PROCESSES.fullmatch(path.name):
            yield name


def import_runs(
    source: Path,
    runs: Path,
    *,
    most_bytes: int = MOST_BYTES,
    enter: Callable[[Sequence[RunRecord]], None] | None = None,
) -> tuple[RunRecord, ...]:
    """Unpack the runs of an archive into a runs folder, which is created if it is missing: all of them, or none.

    Returns the runs, with one line per damaged file. `enter` enters them into the index; if it raises an error, their
    folders are removed again.

    Raises UsageError if it is not such an archive, is damaged, unpacks to more than `most_bytes`, holds other files
    than those of run folders, or one of its runs exists; MachineError if the disk is full or cannot be written.
    """
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
                raise _refused(source, f"the run {name} exists already", "`karolos runs rm` removes it")
        for name in names:
            with writing(runs / name):
                system.replace(place / name, runs / name)
            moved.append(name)
        with writing(runs):
            system.sync_folder(runs)
        records = tuple(RunFolder.open(runs / name).record() for name in names)
        if enter is not None:
            enter(records)
    except BaseException:
        for name in moved:
            system.replace(runs / name, place / name)
        raise
    finally:
        lock.release()
        system.remove_tree(place, ignore_errors=True)
    return records


def remove_unfinished_imports(runs: Path) -> None:
    """Remove files that killed imports have unpacked into this runs folder."""
    for place in runs.glob(f"{UNFINISHED_IMPORT}*"):
        lock = FileLock(place / ".lock")
        if lock.path.exists() and not lock.is_locked():
            system.remove_tree(place, ignore_errors=True)


def _examine(path: Path, source: Path) -> None:
    """Refuse a folder whose name is not the id of its run."""
    try:
        folder = RunFolder.open(path)
    except RunError as error:
        raise _refused(source, f"{path.name}: {error.what}", "export it again") from error
    if folder.id != path.name:
        raise _refused(source, f"the folder {path.name} says that it is the run {folder.id}", "name it by its run")


def _unpack(source: Path, place: Path, most_bytes: int) -> list[str]:
    """Write the files of an archive below `place`; returns the names of the folders in it."""
    try:
        file = source.open("rb")
    except OSError as error:
        raise UsageError(f"the archive cannot be opened ({error.strerror})", where=str(source)) from error
    with file, writing(place):
        if not _GZIP.startswith(file.peek(2)[:2]):
            raise _refused(source, "is not an archive of runs", "`karolos runs export` makes archives")
        try:
            with _Stream(fileobj=file) as stream, tarfile.open(fileobj=stream, mode="r:") as tar:
                found, listed = _extract(tar, place, source, most_bytes)
                # The checksum of the stream stands at its end; tarfile stops before it.
                rest = stream.read(2 * tarfile.RECORDSIZE)
        except (gzip.BadGzipFile, EOFError, OverflowError, ValueError, tarfile.TarError, zlib.error) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise _refused(source, f"the archive cannot be read ({reason})", _AGAIN) from error
    if len(rest) == 2 * tarfile.RECORDSIZE or rest.strip(b"\0"):
        raise _refused(source, "there are data after its last member", _AGAIN)
    if found != listed:
        names = sorted(name for name in {*found, *listed} if found.get(name) != listed.get(name))
        raise _refused(source, f"{names[0]!r} is not as {SUMS} says", _AGAIN)
    if not found:
        raise _refused(source, "it contains no run", "`karolos runs export` makes archives")
    return list(dict.fromkeys(name.partition("/")[0] for name in found))


class _Stream(gzip.GzipFile):
    """An archive's unpacked bytes."""

    @override
    def read(self, size: int | None = -1) -> bytes:
        if size is not None and size > _MOST_AT_ONCE:
            raise tarfile.ReadError("a header is too large")
        return super().read(size)


def _extract(tar: tarfile.TarFile, place: Path, source: Path, most_bytes: int) -> tuple[dict[str, str], dict[str, str]]:
    """Write the members of an archive below `place`: plain files of runs, within limits of number and size.

    Returns the sha256 of each file by its name, and what the archive's list says.
    """
    found: dict[str, str] = {}
    left = most_bytes
    for member in tar:
        name = member.name
        if not member.isreg() or member.issparse():
            raise _refused(source, f"{name!r} is not a plain file", "an archive holds the plain files of runs")
        left -= member.size
        if left < 0 or (name == SUMS and member.size > _MOST_LISTED):
            raise _refused(source, f"it unpacks to more than {most_bytes:,} bytes", "--most raises the limit")
        content = tar.extractfile(member)
        assert content is not None  # it is a plain file
        if name == SUMS:
            return found, {line[66:-1]: line[:64] for line in io.TextIOWrapper(content, "utf-8", newline="\n")}
        if not _MEMBER.fullmatch(name):
            raise _refused(
                source, f"{name!r} is not a file of a run", "an archive holds a folder per run, named by its id"
            )
        if name in found or len(found) == MOST_FILES:
            raise _refused(source, f"{name!r} is in it twice, or it holds more than {MOST_FILES:,} files", _AGAIN)
        target = place / name
        target.parent.mkdir(parents=True, exist_ok=True)
        with target.open("xb+") as written:
            shutil.copyfileobj(content, written)
            written.seek(0)
            found[name] = hashlib.file_digest(written, "sha256").hexdigest()
    raise _refused(source, f"its list of files, {SUMS}, is missing", _AGAIN)


def _refused(source: Path, what: str, hint: str) -> UsageError:
    return UsageError(what, where=str(source), hint=hint)
