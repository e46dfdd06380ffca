"""A launcher that executes runs in this process, one after the other, and may pretend that their processes died."""

from collections import deque
from pathlib import Path

from karolos.experiment.process import execute_folder
from karolos.launchers.interface import Ended, Launcher


class FakeLauncher(Launcher):
    """Each entry of `deaths` is for a started run: True if its process dies before it begins.

    A `blind` launcher knows only that a process has ended, as Slurm's does.
    """

    def __init__(self, *deaths: bool, blind: bool = False) -> None:
        self.deaths = deque(deaths)
        self.blind = blind
        self.started: list[Path] = []
        self.closed: bool | None = None
        self._ended: deque[Ended] = deque()

    def room(self, waiting: int) -> int:
        return 0 if self._ended else 1

    def start(self, folder: Path) -> None:
        self.started.append(folder)
        if self.deaths and self.deaths.popleft():
            self._ended.append(Ended(folder, "its process died", died=True))
        else:
            problem = execute_folder(folder, 1)
            self._ended.append(Ended(folder, "its job ended", died=True) if self.blind else Ended(folder, problem))

    def wait(self, seconds: float) -> Ended | None:
        return self._ended.popleft() if self._ended else None

    def close(self, *, kill: bool) -> None:
        self.closed = kill
