"""Pictures of docs/parts.md, of what its own code makes: python docs/_scripts/parts.py"""

from __future__ import annotations

import os
import re
import tempfile
from contextlib import chdir
from pathlib import Path
from typing import Any

import imageio
import numpy as np

from karolos.environments.robot_task import RobotTask
from karolos.registry import load
from karolos.simulation.engines import make_world
from karolos.simulation.interface import Camera
from karolos.simulation.meshes import stl
from karolos.simulation.shapes import Capsule, Mesh, Sphere, volume_of

PAGE = Path(__file__).parents[1] / "parts.md"
SIZE = 560, 360
ORANGE, BLUE = (0.9, 0.5, 0.1, 1.0), (0.2, 0.45, 0.85, 1.0)


def save(name: str, world: Any, **camera: Any) -> None:
    imageio.imwrite(PAGE.with_suffix("") / f"{name}.png", world.render(*SIZE, Camera(**camera)))


def shapes(names: dict[str, Any]) -> None:
    """The page's ring with its peg, beside a capsule and a ball."""
    world, others = names["world"], []
    for place, shape in (((0.32, 0.14, 0.01), Capsule(0.01, 0.04)), ((0.34, 0.05, 0.015), Sphere(0.015))):
        turned = type(shape)(**{**vars(shape), "orientation": (0.5**0.5, 0.0, 0.0, 0.5**0.5)})
        others.append(world.body([turned], 0.1, BLUE))
        others[-1].place(place)
    save("shapes", world, target=(0.37, 0.1, 0.02), distance=0.35, yaw=30.0, pitch=-35.0)
    for body in (*others, names["peg"]):
        body.place((3.0, 3.0, 0.1))


def mesh(folder: Path) -> None:
    """An L on its legs and one on its tips."""
    outline = [(0, 0), (60, 0), (60, 20), (20, 20), (20, 60), (0, 60)]
    made = []
    for (a, b), (c, d) in zip(outline, outline[1:] + outline[:1], strict=True):
        made += [[(a, b, 0), (c, d, 0), (c, d, 20)], [(a, b, 0), (c, d, 20), (a, b, 20)]]
        made += [[(0, 0, 20), (a, b, 20), (c, d, 20)], [(0, 0, 0), (c, d, 0), (a, b, 0)]]
    path = folder / "l.stl"
    path.write_bytes(stl(np.array(made, np.float32)))
    world = make_world("mujoco")
    z, w, half = -np.sin(np.pi / 8), np.cos(np.pi / 8), 0.5**0.5
    for place, turn, colour in (
        ((0.0, 0.0, 0.02), (half, 0.0, 0.0, half), ORANGE),
        ((0.0, 0.13, 0.058), (half * z, half * w, half * z, half * w), BLUE),
    ):
        body = world.body(
            [Mesh(path, 0.001, collision="convex")], 1200 * volume_of([Mesh(path, 0.001, "convex")]), colour
        )
        body.place(place, turn)
    for _ in range(24):
        world.step()
    save("mesh", world, target=(0.0, 0.07, 0.02), distance=0.5, yaw=60.0, pitch=-25.0)


def main() -> None:
    names: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        for text in re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL):
            exec(text, names)
            if "peg.place" in text:
                shapes(names)
            if "drawer.joint" in text:
                save("fixture", names["world"], target=(0.5, 0.0, 0.05), distance=0.9, yaw=-40.0, pitch=-25.0)
            if "door.place" in text:
                save("mechanism", names["world"], target=(0.58, 0.4, 0.18), distance=1.0, yaw=20.0, pitch=-20.0)
        mesh(Path.cwd())
    os.environ.setdefault("MUJOCO_GL", "egl")
    arm, task = load("robots", "desk_arm"), load("tasks", "seat_plug")  # pip install -e the two packages in examples/
    environment = RobotTask(RobotTask.Settings(), robot=arm(arm.Settings()), task=task(task.Settings()))
    environment.reset(3)
    save("seat_plug", environment.world, target=(0.35, 0.0, 0.1), distance=0.7, yaw=-50.0, pitch=-20.0)
    environment.close()


if __name__ == "__main__":
    main()
