"""Fixtures for tests of several areas."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from importlib.metadata import EntryPoint
from types import SimpleNamespace

import pytest
from support.fake_plugins import FAKES

from karolos import registry

Install = Callable[..., None]
signal.signal(signal.SIGINT, signal.default_int_handler)  # tests press Ctrl-C, also where nohup or a shell ignores it


@pytest.fixture
def fake_plugins(monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Only the plugins of fake_plugins.py are installed; calling the fixture installs one more."""
    points: dict[str, list[SimpleNamespace]] = {kind: [] for kind in registry.KINDS}

    def install(kind: str, name: str, target: str, distribution: str = "fakes") -> None:
        dist = SimpleNamespace(name=distribution, version="1.0")
        points[kind].append(SimpleNamespace(name=name, value=target, dist=dist))
        registry._installed.cache_clear()

    for kind, plugins in FAKES.items():
        for name, target in plugins.items():
            install(kind, name, f"support.fake_plugins:{target}")

    def entry_points(group: str) -> list[SimpleNamespace]:
        return points[group.removeprefix("karolos.")]

    metadata = SimpleNamespace(entry_points=entry_points, EntryPoint=EntryPoint)
    monkeypatch.setattr(registry, "importlib", SimpleNamespace(metadata=metadata))
    registry._installed.cache_clear()
    yield install
    registry._installed.cache_clear()
