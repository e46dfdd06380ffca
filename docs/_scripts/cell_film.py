"""The film of an arm that karolos-deploy moves through its driver `ur` and the fake controller.

python docs/_scripts/cell_film.py BUNDLE NAME   write docs/films/NAME.gif; BUNDLE is from `karolos export --bundle`

The robot's states are kept while the series runs in real time, and drawn afterwards.
"""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

from films import COLOURS, FILMS, HOLD, SIZE

from karolos.export.fake_ur import FakeUR
from karolos.report.video import with_caption, write_gif

HOST, EPISODES, RATE = "127.0.0.14", 2, 12
"""Loopback address of the controller, episodes, pictures per second."""


class Filmed(FakeUR):
    """Keeps the state of the simulated robot at the rate of the pictures."""

    def __init__(self, bundle: Path) -> None:
        self.states: list[tuple[Any, ...]] = []
        super().__init__(bundle, HOST, {})

    def tick(self) -> None:
        super().tick()
        if self.robot.time >= len(self.states) / RATE:
            data = data_of(self.robot.world)
            strokes = self.robot.task.strokes()
            self.states.append((data.qpos.copy(), data.mocap_pos.copy(), strokes, self.robot.outcome()))


def data_of(world: Any) -> Any:
    """MuJoCo's state of a world."""
    return world._simulation.ready()


def main(bundle: Path, name: str) -> None:
    server = Filmed(bundle)
    words = ["karolos-deploy", str(bundle), "--move", "--episodes", str(EPISODES), "--driver", "ur"]
    settings = ["--set", f"host={HOST}", "--set", f"perception={HOST}:{server.port}"]

    def series() -> None:
        print(subprocess.run([*words, *settings], check=False, capture_output=True, text=True).stdout)
        server.end()

    threading.Thread(target=series).start()
    server.serve()
    environment, pictures, moved = server.robot.environment, [], None
    data = data_of(server.robot.world)
    for qpos, markers, strokes, success in server.states:
        if moved is None and abs(qpos - server.states[0][0]).max() < 1e-3:
            continue  # the driver still connects
        moved = True
        data.qpos[:], data.mocap_pos[:] = qpos, markers
        picture = server.robot.world.render(*SIZE, environment.camera, strokes)
        pictures.append(with_caption(picture, "success" if success else "", success=success, failed=False))
    write_gif(
        FILMS / f"{name}.gif", pictures + pictures[-1:] * HOLD, 1000 / RATE, colours=COLOURS, comment="fake controller"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
