"""Fixtures for tests of several areas."""

import os
import signal
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest
import typer
from hypothesis import settings
from support import fork_server
from support.closing import close_all
from support.fake_plugins import FAKES

from karolos import registry
from karolos.core import Array
from karolos.records import provenance
from karolos.robots import poses
from karolos.tasks.throw_planner import ThrowPlanner

Install = Callable[..., None]
os.environ.setdefault("OMP_NUM_THREADS", "1")  # of torch: two that share a busy core wait for each other
settings.register_profile("ours", deadline=None, max_examples=50)  # a busy machine breaks no law
settings.load_profile("ours")
signal.signal(signal.SIGINT, signal.default_int_handler)  # tests press Ctrl-C, also where nohup or a shell ignores it


@pytest.fixture(scope="session", autouse=True)
def this_checkout_is_read_once() -> Iterator[None]:
    """Its state and its source: each of the hundreds of runs would call git three times and look at each file."""
    read, here, hashed, package = provenance.code, Path.cwd(), provenance.fingerprint, Path(registry.__file__).parent
    once, own = cache(read), cache(lambda: hashed(package, follow=False))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(provenance, "code", lambda folder: (once if folder == here else read)(folder))
        patch.setattr(
            provenance,
            "fingerprint",
            lambda path, notes, follow: own() if path == package else hashed(path, notes, follow=follow),
        )
        yield


@pytest.fixture(scope="session", autouse=True)
def throws_are_searched_once() -> Iterator[None]:
    """The furthest throw of an arm with some settings is found once: more than a hundred environments have a throw."""
    search, found = ThrowPlanner._search_throw, dict[object, tuple[Array, ...]]()

    def once(planner: ThrowPlanner) -> tuple[Array, ...]:
        settings = getattr(planner._robot, "settings", None)
        if settings is None:  # a robot of a test
            return search(planner)
        numbers = planner._low, planner._high, planner._speed, planner._home
        known = type(planner._robot), str(settings), planner._height, planner._tool_speed
        key = *known, *(part.tobytes() for part in numbers)
        if key not in found:
            found[key] = search(planner)
        return tuple(part.copy() for part in found[key])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ThrowPlanner, "_search_throw", once)
        yield


@pytest.fixture(scope="session", autouse=True)
def commands_import_once() -> Iterator[None]:
    """Commands and worker processes fork from a server that has imported what each of them would import."""
    with pytest.MonkeyPatch.context() as patch:
        fork_server.install(patch.setattr)
        yield
    fork_server.SERVER.close()


@pytest.fixture(scope="session", autouse=True)
def commands_are_built_once() -> Iterator[None]:
    """Typer makes all commands of `karolos` in .3 s; each call would make them again."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("typer.testing._get_command", cache(typer.main.get_command))
        yield


@pytest.fixture
def real_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands of this test start as a shell starts them."""
    monkeypatch.setattr(fork_server.ForkServer, "starts", lambda *_: False)


@pytest.fixture(autouse=True)
def environments_are_closed() -> Iterator[None]:
    """Close what a test has `opened`."""
    yield
    close_all()


@pytest.fixture(scope="session")
def caches(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("caches")


@pytest.fixture
def quick_proposals(caches: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is assumed of an arm's file is found by later tests, and the first home with some room is taken."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(caches))
    for name, value in {"CONFIGURATIONS": 1, "ENOUGH": 0.2, "GRID": (4, 5, 4)}.items():
        monkeypatch.setattr(poses, name, value)


@pytest.fixture
def fake_plugins(monkeypatch: pytest.MonkeyPatch) -> Install:
    """Only the plugins of fake_plugins.py are installed; calling the fixture installs one more."""
    installed: list[registry.PluginEntry] = []

    def install(kind: str, name: str, target: str, distribution: str = "fakes") -> None:
        installed.append(registry.PluginEntry(kind, name, target, distribution, "1.0"))
        installed.sort(key=lambda one: (registry.KINDS.index(one.kind), one.name, one.distribution))

    for kind, plugins in FAKES.items():
        for name, target in plugins.items():
            install(kind, name, f"support.fake_plugins:{target}")
    monkeypatch.setattr(registry, "_scan", lambda: (tuple(installed), ()))
    return install
