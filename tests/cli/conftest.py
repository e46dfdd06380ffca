"""The runs folder of the commands."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv("KAROLOS_DATABASE", raising=False)
    monkeypatch.setenv("KAROLOS_RUNS", str(tmp_path / "runs"))
    return tmp_path / "runs"
