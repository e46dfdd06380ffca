"""A bundle of a policy that ships, made once for all tests of a process."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from karolos.export.bundle import export_bundle
from karolos.records import RunFolder
from karolos.records.shipped import FOLDER


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle that nobody changes."""
    out = tmp_path_factory.mktemp("bundles") / "ur5_pick"
    export_bundle(RunFolder.open(FOLDER / "ur5_pick"), out)
    return out


@pytest.fixture
def bundle(whole: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(whole, tmp_path / "bundle"))
