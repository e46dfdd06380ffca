"""Films of a run's policy, made on request, one at a time, in a separate process.

python -m karolos.report.ui.films RUN_FOLDER FILE [failures]   what that process does
"""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

from ...errors import KarolosError, UsageError
from ...evaluation.playing import load_player, play, play_failures
from ...experiment.tensorboard_writer import add_film
from ...records import RunFolder
from ...records.checkpoint import names
from ..video import write_film

FILES = {"episodes": "play.mp4", "failures": "play-failures.mp4"}
"""Kind of film -> its file in the run folder."""
EPISODES, WIDTH, HEIGHT = 3, 640, 480


class Films:
    """Makes films; safe for several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._path = Path()
        self._problems: dict[Path, str] = {}

    def begin(self, folder: RunFolder, kind: str) -> None:
        """Start to make a film. Raises UsageError while another film is being made."""
        with self._lock:
            self._look()
            if self._process is not None:
                raise UsageError("another film is being made", hint="wait until it is ready")
            self._path = folder.path / FILES[kind]
            self._problems.pop(self._path, None)
            command = [sys.executable, "-m", "karolos.report.ui.films", str(folder.path), str(self._path), kind]
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                encoding="utf-8",
                errors="replace",
            )

    def state(self, path: Path) -> str:
        """`making`, the reason why a film could not be made, or an empty text."""
        with self._lock:
            self._look()
            return "making" if self._process is not None and path == self._path else self._problems.get(path, "")

    def end(self) -> None:
        """Stop the film that is being made."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()

    def _look(self) -> None:
        """Notice that the film is ready, or failed."""
        if self._process is not None and self._process.poll() is not None:
            said = self._process.communicate()[1].strip().splitlines()
            if self._process.returncode:
                self._problems[self._path] = said[-1] if said else f"it ended with {self._process.returncode}"
            self._process = None


def make(folder: RunFolder, path: Path, kind: str) -> None:
    """Film test episodes of the best policy (also for TensorBoard), or episodes in which the last policy fails.

    Raises as `load_player`, `write_video` and `add_film`.
    """
    name = "best" if kind == "episodes" and "best" in names(folder.checkpoints) else "last"
    chosen = play_failures if kind == "failures" else play
    with load_player(folder, name) as player:
        moments = chosen(player.environment, player.policy, episodes=EPISODES, seed=player.spec.testing.seed)
        beginning = write_film(path, moments, player.environment, (WIDTH, HEIGHT))
    if kind == "episodes":
        add_film(folder, name, beginning, (WIDTH // 2, HEIGHT // 2))


if __name__ == "__main__":
    try:
        make(RunFolder.open(sys.argv[1]), Path(sys.argv[2]), sys.argv[3])
    except KarolosError as error:
        sys.exit(str(error))
