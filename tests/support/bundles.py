"""Bundles of policies that ship."""

import atexit
from functools import cache
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp

import pytest

from karolos.export import bundle
from karolos.records import RunFolder
from karolos.records.shipped import FOLDER
from karolos.report.video import write_film


@cache
def bundle_of(name: str) -> Path:
    """The bundle of a policy that ships, with a small film of few episodes, made once for all tests of a process.

    Nobody changes it.
    """
    out = Path(mkdtemp(prefix="karolos-bundle-")) / name
    atexit.register(rmtree, out.parent, ignore_errors=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bundle, "write_film", lambda *what: write_film(*what[:-1], (64, 48)))
        patch.setattr(bundle, "EPISODES", 6)
        bundle.export_bundle(RunFolder.open(FOLDER / name), out)
    return out
