"""Files that are written completely or not at all, files of JSON lines, and locks that the end of a process releases.

An error of the operating system during writing becomes a MachineError that says what to do. `fingerprint` identifies
the content of files that an experiment reads.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import re
import stat
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar
from urllib.parse import unquote

from .. import system
from ..errors import KarolosError, MachineError, UsageError, closest

SPECS = next(path for up in (1, 2) if (path := Path(__file__).parents[up] / "specs").is_dir())
"""Folder of the shipped specs, in the installed package or in a checkout."""
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})
_FORBIDDEN = frozenset({errno.EACCES, errno.EPERM, errno.EROFS})
_POLL_SECONDS = 0.02
T = TypeVar("T")
MOST_FILES, MOST_BYTES = 20_000, 1 << 32
"""Largest folder that is identified by its content. A larger one is identified by its name."""
LARGE_FILE, SAMPLES, SAMPLE = 1 << 26, 256, 1 << 16
"""A larger file (bytes) is identified by its size and SAMPLES parts of SAMPLE bytes, so that specs stay fast."""
_NAMING = (".urdf", ".xml", ".mjcf", ".xacro", ".sdf", ".py", ".json", ".toml", ".yaml", ".yml")
_NAMED = re.compile(r"""["']([^"'<>\0\r\n]{1,300}\.\w{1,8})["']""")
_UNQUOTED = re.compile(r"""[:-][ \t]+([^\s"'#]{1,300}\.\w{1,8})[ \t]*$""", re.MULTILINE)
"""A name in YAML."""
_JOINED = re.compile(r"""["']\s*[,/]\s*f?["']|\{\w+\}/""")
"""Text between the parts of a path in Python code, or before the path in an f-string."""
_FOLDER = re.compile(r"""\b(?:mesh|asset)dir\s*=\s*["']([^"'<>]{1,300})["']""")
"""Where an MJCF file says that its meshes are."""
_IMPORTED = re.compile(r"^[ \t]*(?:from|import)[ \t]+(\w[\w., \t]*)", re.MULTILINE)
_NO_SOURCE = re.compile(r"[.#].*|.*~|.*\.(?:py[co]|nb[ic])|__pycache__|specs|runs|shipped_runs")
"""Names in a package that are not source: hidden, compiled and editor's files, specs, runs."""
LOCK_SECONDS = 20.0
"""Time that `locked` waits for a process that writes labels or a line. Writing takes milliseconds."""


class Lines(NamedTuple, Generic[T]):
    """The values of a file of lines, and one text per line that cannot be read."""

    rows: tuple[T, ...]
    problems: tuple[str, ...]


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn an OSError of the block into a MachineError about `path`."""
    try:
        yield
    except OSError as error:
        raise _explained(error, path) from error


def _explained(error: OSError, path: Path) -> MachineError:
    if error.errno in _FULL:
        return MachineError("the disk is full", where=str(path), hint="free some space; the old content is intact")
    if error.errno == errno.EFBIG:
        hint = "raise the limit (`ulimit -f`), or name another folder; the old content is intact"
        return MachineError("the file is larger than this shell or disk allows", where=str(path), hint=hint)
    if error.errno in _FORBIDDEN:
        return MachineError("cannot be written", where=str(path), hint="change its permissions or name another folder")
    if isinstance(error, NotADirectoryError | FileExistsError):
        return MachineError("a file is in the way of a folder", where=str(path), hint="name another folder")
    return MachineError(f"cannot be written ({error.strerror or error})", where=str(path))


def below(root: Path, name: str) -> Path:
    """`root / name`. Raises UsageError if it is not below `root` after links are followed."""
    path = root / name
    if root.resolve() not in path.resolve().parents:
        raise UsageError(f"{name!r} leads outside of {root}", hint="give a plain name")
    return path


def user_cache() -> Path:
    """The folder of karolos in this user's cache folder. Raises RuntimeError if there is no known home."""
    return system.user_cache() / "karolos"


def is_portable(name: str) -> bool:
    """Whether Windows, too, allows a file of this name."""
    return name.partition(".")[0].lower() not in system.RESERVED_NAMES and not name.endswith(".")


def find_named(name: str, folder: Path) -> Path | None:
    """The file that a file of `folder` calls `name`, e.g. a mesh in a URDF; None if it does not exist.

    A `package://` name is searched in this folder and its parents, with and without the name of the package. A name
    with a scheme may have %20 for a space, and one without may have the backslashes of Windows.
    """
    scheme, separator, rest = name.partition("://")
    rest = re.sub("^/(?=[A-Za-z]:)", "", rest)  # file:///C:/meshes/arm.stl
    forms: tuple[str, ...] = (rest, unquote(rest)) if separator else (name, name.replace("\\", "/"))
    around: tuple[Path, ...] = folder, folder.parent
    if scheme in ("package", "model") and separator:
        around = folder, *folder.parents
        forms = (*forms, *(form.partition("/")[2] for form in forms))  # without the name of the package
    places = (above / form for above in around for form in forms)
    return next((place.resolve() for place in places if os.path.isfile(place)), None)


INSTALLED = "installed:"
"""Prefix of a file in a package on this machine: installed:PACKAGE/the/end/of/its/path.urdf."""


def installed_file(name: str) -> Path | None:
    """The file that `installed:PACKAGE/PATH` names; None if it does not exist."""
    from importlib import metadata  # noqa: PLC0415  (every command imports this module, and metadata imports email)

    package, _, end = name.removeprefix(INSTALLED).partition("/")
    try:
        files = metadata.files(package) or []
    except (metadata.PackageNotFoundError, ValueError):
        return None
    return next((Path(str(one.locate())).resolve() for one in files if f"/{one.as_posix()}".endswith(f"/{end}")), None)


def file_of(name: str | Path) -> Path:
    """The file of a path or of installed:PACKAGE/PATH; a name that no package has stays as it is."""
    return (installed_file(str(name)) if str(name).startswith(INSTALLED) else None) or Path(name)


def install_hint(name: str) -> str | None:
    """A hint how to get the file of a name installed:PACKAGE/PATH that does not exist; None for a path."""
    from importlib import metadata  # noqa: PLC0415  (see `installed_file`)

    if not name.startswith(INSTALLED):
        return None
    package = name.removeprefix(INSTALLED).partition("/")[0]
    try:
        files = metadata.files(package) or []
    except (metadata.PackageNotFoundError, ValueError):
        return f"pip install {package}"
    ends = sorted({one.name for one in files if one.suffix.lower() in (".urdf", ".xml", ".mjcf", ".xacro")})
    match = closest(name.rpartition("/")[2], ends)
    return f"{package} is installed, but has no such file{f'; it has {match}' if match else ''}"


def fingerprint(path: Path, unread: list[str] | None = None, *, follow: bool = True) -> str | None:
    """SHA-256 (hex) of a file or of a folder's source, with all files that are named there; None for anything else.

    A URDF names its meshes. A module names the files in its texts, and neighbouring modules and packages.

    Args:
        path: of the file or the folder.
        unread: gets a line for each file that is ignored, such as a dangling link or a folder that is too large.
        follow: include the named files.
    """
    notes: list[str] = [] if unread is None else unread
    pending = list(_source(path, notes)) if os.path.isdir(path) else [("", path)] if os.path.isfile(path) else []
    total, digest, seen = 0, hashlib.sha256(), {str(one) for _, one in pending}
    for name, one in pending:  # which grows
        if len(pending) > MOST_FILES or total > MOST_BYTES:
            notes.append(f"more than {MOST_FILES:,} files or {MOST_BYTES:,} bytes: its files are ignored")
            return None
        content, others = "unread", tuple[str, ...]()
        try:
            status = os.stat(one)
            if not stat.S_ISREG(status.st_mode):
                raise OSError("not a plain file")
            total += min(status.st_size, LARGE_FILE)
            content, others = _content(str(one), status.st_mtime_ns, status.st_size, status.st_ino)
        except OSError as error:
            notes.append(f"{name or one.name}: {error.strerror or error}")
        digest.update(f"{name}\0{content}\n".encode(errors="surrogateescape"))
        for other in others if follow else ():
            inside: Iterable[tuple[str, Path]] = ()
            if other.endswith("/"):
                inside = _source(one.parent / other, notes) if os.path.isdir(one.parent / other) else ()
            elif (found := find_named(other, one.parent)) is not None:
                inside = [("", found)]
            new = [(other + below, file) for below, file in inside if str(file) not in seen]
            seen |= {str(file) for _, file in new}
            pending += new
    return digest.hexdigest() if pending else None


def copy_named(path: Path, folder: Path) -> Path:
    """Copy a file, and the files that it names, into a folder where `find_named` finds them. Returns the copy.

    The copy has the original's fingerprint. Files with an absolute name are not copied.
    """
    with writing(folder):
        status = os.stat(path)
        names = _content(str(path), status.st_mtime_ns, status.st_size, status.st_ino)[1]
        plain = {name: name.partition("://")[2] or name for name in names}
        up = max((os.path.normpath(one).count("..") for one in plain.values()), default=0)
        copy = folder.joinpath(*["robot"] * up, path.name)
        for name, one in {**plain, str(path): path.name}.items():
            found = path if name == str(path) else find_named(name, path.parent)
            if found is not None and not os.path.isabs(one):
                target = Path(os.path.normpath(copy.parent / one))
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(found.read_bytes())
    return copy


def _source(folder: Path, notes: list[str]) -> Iterator[tuple[str, Path]]:
    """Name and path of the files below a folder, up to a few more than allowed. A file with two links is read once."""
    visited, count = set[str](), 0
    for place, folders, names in os.walk(folder, followlinks=True, onerror=lambda error: notes.append(str(error))):
        visited.add(os.path.realpath(place))
        inside = [one for one in sorted(folders) if not _NO_SOURCE.fullmatch(one)]
        folders[:] = [one for one in inside if os.path.realpath(os.path.join(place, one)) not in visited]
        for path in (Path(place, name) for name in sorted(names) if not _NO_SOURCE.fullmatch(name)):
            count += 1
            yield path.relative_to(folder).as_posix(), path
        if count > MOST_FILES:
            return


@lru_cache(maxsize=2 * MOST_FILES)
def _content(path: str, _: int, size: int, *__: int) -> tuple[str, tuple[str, ...]]:
    """SHA-256 (hex) of a file, and the names in it; packages end in /. The numbers change with the file."""
    with open(path, "rb") as file:
        if size > LARGE_FILE:
            digest = hashlib.sha256(str(size).encode())
            for part in range(SAMPLES):
                file.seek(part * (size - SAMPLE) // (SAMPLES - 1))
                digest.update(file.read(SAMPLE))
            return digest.hexdigest(), ()
        data = file.read()
    found = hashlib.sha256(data).hexdigest()
    if not path.lower().endswith(_NAMING):
        return found, ()
    text = data.decode(errors="replace")
    named = _NAMED.findall(text)
    named += [f"{folder}/{name}" for folder in _FOLDER.findall(text) for name in named]
    if path.lower().endswith((".yaml", ".yml")):
        named += _UNQUOTED.findall(text)
    if path.endswith(".py") and "-packages" not in path:  # site-packages and dist-packages hold foreign modules
        named += _NAMED.findall(_JOINED.sub(lambda joint: "/" if "{" not in joint[0] else "", text))
        lines = (line.partition(" import")[0].split(",") for line in _IMPORTED.findall(text))
        modules = {module.split()[0].partition(".")[0] for line in lines for module in line if module.strip()}
        named += [f"{module}{end}" for module in sorted(modules - {"karolos"}) for end in (".py", "/")]
    return found, tuple(dict.fromkeys(named))


def remove_leftovers(folder: Path, pattern: str) -> None:
    """Remove files and folders that dead processes of this user left behind, if possible.

    Args:
        folder: where they are.
        pattern: a regular expression for their names; its first group is the id of the process.
    """
    with contextlib.suppress(OSError):
        for entry in list(os.scandir(folder)):
            found = re.fullmatch(pattern, entry.name)
            if not found or system.is_alive(int(found[1])):
                continue
            with contextlib.suppress(OSError):
                if not system.is_own(entry.stat(follow_symlinks=False)):
                    continue
                if entry.is_dir(follow_symlinks=False):
                    system.remove_tree(entry.path, ignore_errors=True)
                else:
                    system.remove(entry.path)


UNFINISHED = r"\..+\.(\d+)\.tmp"
"""Names of the temporary files of `write_whole`."""


def write_whole(path: Path, text: str, *, durable: bool = True) -> None:
    """Write a file so that a reader sees the old or the new content, never a part.

    Args:
        path: of the file.
        text: its content.
        durable: whether to wait until it is on the disk.

    Raises:
        MachineError: the disk is full or the folder cannot be written; the old content stays.
    """
    fresh = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    with writing(path):
        try:
            with fresh.open("w", encoding="utf-8", newline="\n") as file:
                file.write(text)
                if durable:
                    file.flush()
                    system.sync(file.fileno())
            system.replace(fresh, path)
        finally:
            fresh.unlink(missing_ok=True)  # exists only after an error
        if durable:
            system.sync_folder(path.parent)


def write_json(path: Path, value: Mapping[str, Any], *, durable: bool = True) -> None:
    """Write an indented JSON object as `write_whole` does."""
    write_whole(path, json.dumps(value, indent=2, allow_nan=False) + "\n", durable=durable)


def append_lines(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Append JSON objects, one a line, and wait until they are on the disk.

    An incomplete last line, which a killed process left, is removed first.

    Raises:
        MachineError: the disk is full or the file cannot be written; the lines before stay as they are.
    """
    lines = "".join(json.dumps(row, separators=(",", ":"), allow_nan=False) + "\n" for row in rows).encode()
    with writing(path):
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | system.BINARY, 0o666)
        try:
            end = _cut_torn_line(descriptor)
            try:
                while lines:
                    lines = lines[os.write(descriptor, lines) :]
                system.sync(descriptor)
            except OSError:
                with contextlib.suppress(OSError):  # the first error is reported
                    os.ftruncate(descriptor, end)
                raise
        finally:
            os.close(descriptor)


def _cut_torn_line(descriptor: int) -> int:
    """Remove an incomplete last line; returns the size of the rest."""
    size = start = os.fstat(descriptor).st_size
    tail = b""
    while start and b"\n" not in tail:
        end, start = start, max(start - 65536, 0)
        os.lseek(descriptor, start, os.SEEK_SET)
        tail = os.read(descriptor, end - start) + tail
    whole = start + tail.rfind(b"\n") + 1
    if whole < size:
        os.ftruncate(descriptor, whole)
    return whole


def parse_object(data: bytes) -> dict[str, Any] | None:
    """A JSON object without nan, infinities and lone surrogates; None for anything else."""
    from pydantic_core import from_json  # noqa: PLC0415  (`karolos --help` reads no JSON)

    try:
        value = from_json(data, allow_inf_nan=False)
    except ValueError:
        return None
    return value if isinstance(value, dict) else None


def read_lines(path: Path) -> Lines[dict[str, Any]]:
    """The JSON objects in the lines of a file; as `read_values`."""
    return read_values(path, parse_object, "JSON object")


def read_values(path: Path, parse: Callable[[bytes], T | None], what: str) -> Lines[T]:
    """The values in the lines of a file; a missing file is empty. Invalid lines are left out and become problems.

    Args:
        path: of the file.
        parse: gives the value of a line, or None if the line is invalid.
        what: a valid line holds, for the problems.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return Lines((), ())
    except OSError as error:
        return Lines((), (f"{path.name}: cannot be read ({error.strerror})",))
    *whole, rest = data.split(b"\n")
    values = [parse(line) for line in whole]
    problems = [f"{path.name}:{number}: not a {what}; left out" for number, row in enumerate(values, 1) if row is None]
    if rest:
        problems.append(f"{path.name}:{len(whole) + 1}: the last line is torn; left out")
    return Lines(tuple(row for row in values if row is not None), tuple(problems))


def new_lines(path: Path, start: int) -> tuple[list[dict[str, Any]], int]:
    """The JSON objects of the complete lines from byte `start` on, and where they end. A missing file is empty.

    If the file has become shorter, reading continues at its new end.
    """
    try:
        with path.open("rb") as file:
            start = min(start, file.seek(0, os.SEEK_END))
            file.seek(start)
            whole, newline, _ = file.read().rpartition(b"\n")
    except OSError:
        return [], start
    rows = [parse_object(line) for line in whole.split(b"\n")]
    return [row for row in rows if row is not None], start + len(whole + newline)


def read_object(path: Path) -> dict[str, Any] | None:
    """The JSON object in a file; None if the file cannot be read or holds something else."""
    try:
        return parse_object(path.read_bytes())
    except OSError:
        return None


class FileLock:
    """An exclusive lock on a file. The operating system releases it when the process ends, also after a kill."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._descriptor: int | None = None

    @property
    def held(self) -> bool:
        """Whether this object holds the lock."""
        return self._descriptor is not None

    def acquire(self, seconds: float = 0.0) -> bool:
        """Try for `seconds` to lock; returns whether it succeeded.

        Raises:
            MachineError: the file cannot be created or its file system has no locks.
        """
        if self.held:
            return True
        deadline = time.monotonic() + seconds
        with writing(self.path):
            descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o666)
            try:
                while not system.try_lock(descriptor):
                    if time.monotonic() >= deadline:
                        return False
                    time.sleep(_POLL_SECONDS)
                self._descriptor = descriptor
            finally:
                if not self.held:
                    os.close(descriptor)
        return True

    def release(self) -> None:
        """Unlock. Safe to call twice."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def remove(self) -> None:
        """Unlock, and remove the file."""
        if system.WINDOWS:  # where an open file cannot be removed
            self.release()
        system.remove(self.path, missing_ok=True)
        self.release()

    def is_locked(self) -> bool:
        """Whether any process holds the lock. It takes a shared lock: readers do not exclude each other."""
        if self.held:
            return True
        try:
            descriptor = os.open(self.path, os.O_RDONLY)
        except OSError:
            return False
        try:
            return not system.try_lock(descriptor, shared=True)
        except OSError:
            return False  # the file system has no locks
        finally:
            os.close(descriptor)


@contextlib.contextmanager
def locked(path: Path, refusal: KarolosError | None = None, seconds: float | None = None) -> Iterator[None]:
    """Hold the lock of a file. A missing folder is created.

    Args:
        path: of the file.
        refusal: error to raise if another process keeps the lock; None: a MachineError.
        seconds: time to wait; None: LOCK_SECONDS, enough for locks of milliseconds.

    Raises:
        MachineError: the file cannot be created.
    """
    with writing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    lock = FileLock(path)
    if not lock.acquire(LOCK_SECONDS if seconds is None else seconds):
        what = f"another process keeps {path.name} locked"
        raise refusal or MachineError(what, where=str(path.parent), hint="try again")
    try:
        yield
    finally:
        lock.release()
