"""Films of recorded episodes. Each environment writes the films of its episodes while it steps."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from ..core import Array, Environment, Step
from ..environments.build import build_environment
from ..environments.robot_task import WRIST, RobotTask
from ..errors import UsageError
from ..specification.parts import Recipe
from .playing import Around, build_recorded

CAMERAS = ("front", "wrist")
"""front: the camera of the task's films. wrist: behind and above the tool; it moves with the tool, without turning."""


class Filmed(Around):
    """An environment that films its episodes, one picture for each action.

    Args:
        environment: of a robot and a task; it may be `WithExpert`.
        folder: of the films, SEED-CAMERA.mp4.
        cameras: some of CAMERAS.
        rate: pictures per second of the film.

    Raises UsageError if the environment has no cameras.
    """

    def __init__(
        self, environment: Environment, folder: Path, cameras: tuple[str, ...], size: tuple[int, int], rate: int
    ) -> None:
        super().__init__(environment)
        self._world = _with_cameras(environment.environment if isinstance(environment, Around) else environment)
        self._folder, self._cameras, self._size, self._rate = folder, cameras, size, rate
        self._films: dict[str, Any] = {}

    def reset(self, seed: int) -> Step:
        self._end()
        step = super().reset(seed)
        for camera in self._cameras:
            self._films[camera] = _film(self._folder / f"{seed}-{camera}.mp4", self._size, self._rate)
        self._add()
        return step

    def step(self, action: Array) -> Step:
        step = super().step(action)
        if step.terminated or step.truncated:
            self._end()
        else:
            self._add()
        return step

    def _add(self) -> None:
        for name, film in self._films.items():
            camera = self._world.camera
            if name == "wrist":
                camera = replace(WRIST, target=self._world.robot.tool.position, base=camera.base)
            film.send(self._world.world.render(*self._size, camera).tobytes())

    def _end(self) -> None:
        while self._films:
            self._films.popitem()[1].close()  # which waits until the film is whole

    def close(self) -> None:
        self._end()
        super().close()


def _with_cameras(environment: Environment) -> RobotTask:
    """The environment, if it has cameras. Raises UsageError otherwise."""
    if not isinstance(environment, RobotTask):
        raise UsageError("only a robot with a task has cameras", hint="leave out --camera")
    return environment


def build_filmed(
    recipe: Recipe, *, expert: bool, folder: Path, cameras: tuple[str, ...], size: tuple[int, int], rate: int
) -> Filmed:
    """The environment of a recipe, with or without its expert, filmed. Raises as `build_environment`."""
    return Filmed(build_recorded(recipe, expert=expert), folder, cameras, size, rate)


def _film(path: Path, size: tuple[int, int], rate: int) -> Iterator[None]:
    from imageio_ffmpeg import write_frames  # noqa: PLC0415

    often = ["-g", "2", "-threads", "1"]  # a reader that wants one picture decodes two
    film: Any = write_frames(path, size, fps=rate, codec="libx264", quality=8, macro_block_size=2, output_params=often)
    film.send(None)
    return film  # type: ignore[no-any-return]


def poses(recipe: Recipe, names: tuple[str, ...], size: tuple[int, int]) -> dict[str, dict[str, Any]]:
    """Description of each camera: size in pixels, lengths in m, angles in degrees.

    Raises UsageError for a name that is not in CAMERAS, and if the environment has no cameras.
    """
    with closing(build_environment(recipe)) as environment:
        front = _with_cameras(environment).camera
    if unknown := set(names) - set(CAMERAS):
        raise UsageError(f"there is no camera {min(unknown)!r}", hint=f"there are {' and '.join(CAMERAS)}")
    of = {"front": asdict(front), "wrist": {**asdict(WRIST), "target": "tool"}}
    return {name: {"width": size[0], "height": size[1], **of[name]} for name in names}
