"""Tests of sources on targets in the processes of a launcher. The folder of a test says what to play, in test.json.

The result goes into the folder of the source's run, as that of `karolos test`; the test's own folder is removed then.
"""

from __future__ import annotations

import shutil
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from .. import checkpoint
from ..core.launcher import Launcher
from ..errors import KarolosError, RunError
from ..evaluation.transfer_test import transfer_test
from ..files import read_object, write_json, write_whole, writing
from ..records import RunFolder, provenance, transfer_results
from ..records.decode import from_json
from ..records.transfer_results import TransferResult
from .signals import StopRequest, StopRequestedError, stop_on_signals

REQUEST, STOP = "test.json", "stop"
RETRIES = 1
"""How many times a test is played again after its process died."""


@dataclass(frozen=True)
class Request:
    """What to play."""

    run: str
    """Folder of the source's run."""
    checkpoint: str
    overrides: tuple[str, ...]
    """The target's settings."""
    episodes: int
    seed: int
    """Root of the episodes' seeds."""

    def result(self) -> TransferResult | None:
        """The result in the run's folder; None if this policy has not played these episodes yet."""
        folder = RunFolder.open(self.run)
        sha256 = checkpoint.digest(folder.checkpoints, self.checkpoint, "agent")
        wanted = (sha256, self.overrides, False, self.seed, self.episodes)
        for done in transfer_results.read(folder)[0]:
            if (done.sha256, done.overrides, done.randomized, done.seed, done.result.episodes) == wanted:
                return done
        return None


def is_test(folder: Path) -> bool:
    """Whether a folder is that of a test."""
    return (folder / REQUEST).is_file()


def execute_test(folder: Path, driver: int | None = None) -> str | None:
    """Play the test of a folder, for another process. Returns why it could not be played.

    Args:
        folder: of the test.
        driver: id of the process with whose end the test stops.
    """
    try:
        content = read_object(folder / REQUEST) or {}
        request = from_json(Request, content)
        if request is None:
            raise RunError("it says no test", where=str(folder / REQUEST), hint="remove the folder")
        with stop_on_signals(file=folder / STOP, driver=driver) as stop:
            try:
                provenance.check_software(content, str(folder))
                transfer_test(
                    RunFolder.open(request.run),
                    request.overrides,
                    checkpoint=request.checkpoint,
                    episodes=request.episodes,
                    seed=request.seed,
                    on_round=lambda _: stop.check(),
                )
            except StopRequestedError:
                pass
            except KarolosError as error:
                write_json(folder / REQUEST, content | {"problem": str(error)})
                raise
    except KarolosError as error:
        return str(error)
    return None


def play_tests(
    requests: Iterable[tuple[Path, Request]],
    launcher: Launcher,
    stop: StopRequest,
    heard: Callable[[Request, TransferResult | None, str | None], None],
) -> None:
    """Play tests through a launcher, except those that were played already.

    Args:
        requests: the folder of each test, which need not exist, and what to play.
        launcher: executes the tests.
        stop: breaks them off; nothing is written then.
        heard: is called with each test's result or, if it has none, with the reason.
    """
    waiting: deque[tuple[Path, Request, int]] = deque()
    for folder, request in requests:
        if (known := request.result()) is not None:
            heard(request, known, None)
        else:
            waiting.append((folder.resolve(), request, 0))
    active: dict[Path, tuple[Request, int]] = {}
    while waiting or active:
        if stop.requested:
            waiting.clear()
            for folder in active:
                write_whole(folder / STOP, stop.reason or "stopped")
        for _ in range(min(launcher.room(len(waiting)), len(waiting))):
            folder, request, deaths = waiting.popleft()
            _prepare(folder, request)
            active[folder] = request, deaths
            launcher.start(folder)
        ended = launcher.wait(launcher.poll_seconds) if waiting or active else None
        if ended is None:
            continue
        request, deaths = active.pop(ended.folder)
        result, problem = request.result(), (read_object(ended.folder / REQUEST) or {}).get("problem")
        if result is None and problem is None and ended.died and deaths < RETRIES and not stop.requested:
            waiting.appendleft((ended.folder, request, deaths + 1))
            continue
        shutil.rmtree(ended.folder)
        with suppress(OSError):
            ended.folder.parent.rmdir()  # of the last one
        if result is not None or not stop.requested:
            heard(request, result, None if result else str(problem or ended.problem or "it has no result"))


def _prepare(folder: Path, request: Request) -> None:
    content: dict[str, Any] = asdict(request) | provenance.software()
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / STOP).unlink(missing_ok=True)  # of an earlier process
    write_json(folder / REQUEST, content)
