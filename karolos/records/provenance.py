"""Provenance of a run: versions, command line and code. `recorded` in `karolos.errors` removes secrets."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib import metadata
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..errors import MachineError, redact, without_folders
from ..registry import KINDS, PluginEntry, entries
from ..system.files import fingerprint
from .run_records import GitCommit

GIT_SECONDS = 10.0
"""Time limit of one call of git; the run goes on without its answer."""
DIFF_BYTES = 1_000_000
"""Longer differences are cut off: data files do not belong in a run folder."""
UNTRACKED_FILES = 50
_BETWEEN = "\x1f"
"""Separates arguments. An argument contains no such white space."""

_LOADED: dict[str, tuple[dict[str, ModuleSpec | None], str]] = {}
"""Package or module -> what this process has loaded of it, with the hash of its source then. A reload changes both."""

_SECRET_FILES = (
    *(".env*", "*.env", "*.pem", "*.key", "*.p12", "*.pfx", "*.ppk", "*.kdbx", "*.jks", "*.keystore", "*.tfvars"),
    *("id_rsa*", "id_dsa*", "id_ecdsa*", "id_ed25519*", "*secret*", "*credential*", "*passw*", "*api*key*.*"),
    *("*token*.json", "*token*.txt", ".netrc", "_netrc", ".pgpass", ".npmrc", ".pypirc", ".htpasswd", ".dockercfg"),
    *("kubeconfig", ".aws/**", ".ssh/**", ".kube/**", ".docker/**", ".gnupg/**"),
)
"""Files whose changes code.diff leaves out."""


def command_line() -> list[str]:
    """The command that started this process, without folders of absolute paths and without secrets."""
    program, *arguments = sys.argv or [""]
    return [Path(program).name, *without_folders(redact(_BETWEEN.join(arguments))).split(_BETWEEN)[: len(arguments)]]


@cache
def versions() -> dict[str, str]:
    """Versions of Python, karolos, its dependencies, and every distribution of plugins."""
    names = {"karolos"}
    for requirement in metadata.requires("karolos") or []:
        if "extra ==" not in requirement:
            names.add(re.split(r"[^A-Za-z0-9._-]", requirement, maxsplit=1)[0])
    found = {entry.distribution: entry.version for entry in _plugins()}
    for name in names:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return {"python": platform.python_version(), **dict(sorted(found.items()))}


def packages(spec: Mapping[str, Any]) -> set[str]:
    """The foreign packages and modules that a resolved spec names: by their plugins, or as "module:name"."""
    named = {text for key, value in spec.items() if key != "name" for text in _texts(value)}
    modules = {re.split("[.:]", value)[0] for value in named if re.fullmatch(r"[A-Za-z_][\w.]*:[\w.-]+", value)}
    return modules | {entry.package for entry in _plugins() if entry.name in named}


def _texts(value: object) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    for one in value.values() if isinstance(value, Mapping) else value if isinstance(value, list | tuple) else ():
        yield from _texts(one)


def sources(names: Iterable[str] | None = None, unread: list[str] | None = None) -> dict[str, str]:
    """SHA-256 (hex) of the source of karolos and of these installed packages and modules, by default of all plugins.

    `unread` gets a line for each ignored file, see `fingerprint`.
    """
    found = {}
    for name in sorted({"karolos", *({entry.package for entry in _plugins()} if names is None else names)}):
        try:
            spec = find_spec(name)
        except Exception:  # any importer may raise it
            continue
        places = spec.submodule_search_locations or (spec.origin or "",) if spec else ()
        notes: list[str] = []
        prints = [one for place in places if (one := fingerprint(Path(place), notes, follow=name != "karolos"))]
        if unread is not None:
            unread += [f"{name}: {note}" for note in notes]
        if prints:
            found[name] = prints[0] if len(prints) == 1 else hashlib.sha256("".join(prints).encode()).hexdigest()
    return found


def edited_since_import(found: Mapping[str, str]) -> list[str]:
    """The names in `sources` whose files changed after this process loaded them, if nothing of them was reloaded.

    A change before the first call is not seen.
    """
    edited = []
    for name, digest in found.items():
        parts = [one for one in list(sys.modules) if one == name or one.startswith(f"{name}.")]
        loaded = {one: getattr(sys.modules[one], "__spec__", None) for one in parts}
        before, known = _LOADED.get(name, (loaded, digest))
        if known != digest and before and all(loaded.get(one) is spec for one, spec in before.items()):
            edited.append(name)
        else:
            _LOADED[name] = (loaded, digest)
    return edited


def source_of_others(found: Mapping[str, str]) -> str | None:
    """One hash of `sources`, without karolos itself; None if that is all."""
    others = sorted(f"{name} {digest}" for name, digest in found.items() if name != "karolos")
    return hashlib.sha256("\n".join(others).encode()).hexdigest() if others else None


def _plugins() -> Iterator[PluginEntry]:
    """The foreign plugins."""
    return (entry for kind in KINDS for entry in entries(kind) if entry.package != "karolos")


def software() -> dict[str, Any]:
    """`versions` and `sources` of this process."""
    return {"versions": versions(), "sources": sources()}


def edited(about: Mapping[str, Any], files: Mapping[str, str]) -> list[str]:
    """Settings whose files (`Spec.files`) have changed since a run's run.json, and modules whose source has."""
    modules = {name: digest for name, digest in (about.get("sources") or {}).items() if name != "karolos"}
    made, now = {**modules, **(about.get("files") or {})}, {**sources(modules), **files}
    return sorted(name for name, digest in made.items() if now.get(name) != digest)


def other_software(other: Mapping[str, Any]) -> list[str]:
    """Differences between `software` and this process: of versions, or else of sources. Unknown sources are ignored."""
    own = versions()
    found = [(name, own.get(name, "missing"), there) for name, there in sorted(other.get("versions", {}).items())]
    if different := [f"{name} is {here} here and {there} there" for name, here, there in found if here != there]:
        return different
    known = other.get("sources") or {}
    now = sources(known)
    return [f"the source of {name} is another one" for name in known if known[name] != now.get(name)]


def check_software(launched: Mapping[str, Any], where: str) -> None:
    """Raise a MachineError if the software differs between this process and its launcher, see `software`."""
    found = other_software(launched)
    if found:
        raise MachineError(
            f"{platform.node()} would run other software: {'; '.join(found)}",
            where=where,
            hint="install the same on all machines",
        )


def code(folder: Path) -> tuple[GitCommit, str] | None:
    """The git work tree that contains `folder`, and the differences of tracked files from the commit, cut off at 1 MB.

    None without one, or if git is missing or does not answer.
    """
    commit = _git(folder, "rev-parse", "--verify", "HEAD")
    status = _git(folder, "status", "--porcelain", "-z", "--untracked-files=normal")
    if commit is None or status is None:
        return None
    entries = [entry for entry in status.split("\0") if entry]
    untracked = [entry[3:] for entry in entries if entry.startswith("??")]
    dirty = any(not entry.startswith("??") for entry in entries)
    files = (":/", *(f":(top,exclude,icase,glob)**/{pattern}" for pattern in _SECRET_FILES))
    diff = _git(folder, "diff", "--no-ext-diff", "--no-textconv", "--no-color", "HEAD", "--", *files) or ""
    return {"commit": commit.strip(), "dirty": dirty, "untracked": untracked[:UNTRACKED_FILES]}, redact(diff)


def _git(folder: Path, *arguments: str) -> str | None:
    """The output of git, cut off at DIFF_BYTES; None if it fails. Programs named in a git configuration do not run."""
    command = ["git", "-c", "core.fsmonitor=false", "-c", "core.hooksPath=", "--no-pager", *arguments]
    environment = {**os.environ, "GIT_OPTIONAL_LOCKS": "0", "GIT_TERMINAL_PROMPT": "0", "LC_ALL": "C"}
    how: dict[str, Any] = {"env": environment, "stdin": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    try:
        output: bytes = subprocess.check_output(command, cwd=folder, timeout=GIT_SECONDS, **how)
    except (OSError, subprocess.SubprocessError):
        return None
    return output[:DIFF_BYTES].decode("utf-8", "replace")
