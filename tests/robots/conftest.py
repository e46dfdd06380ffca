"""An arm's file for tests of what is read from files."""

from pathlib import Path

import pytest
from support.fourth_robot import exported_arm

from karolos.robots import from_file


@pytest.fixture
def arm(tmp_path: Path, quick_proposals: None) -> Path:
    """A URDF with two fingers."""
    from_file._cached.cache_clear()
    return exported_arm(tmp_path).model.urdf
