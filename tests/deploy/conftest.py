"""A bundle of a policy that ships."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from support.bundles import bundle_of


@pytest.fixture
def whole() -> Path:
    """A bundle that nobody changes."""
    return bundle_of("ur5_pick")


@pytest.fixture
def bundle(whole: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(whole, tmp_path / "bundle"))
