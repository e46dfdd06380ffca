"""MuJoCo's OpenGL renderer, without a window that shows."""

from __future__ import annotations

import os
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core import FloatArray
from ...errors import MachineError
from ...system import RENDERER_HINT, RENDERERS
from ..picture import Eye

DRAWN = (False, True, False, False, False, False)
"""Groups of geoms that are drawn: not the floor, which pictures draw themselves, and no hidden collision shapes."""


class Renderer:
    """Draws the bodies of one model in pictures of one size."""

    def __init__(self, api: Any, model: Any, width: int, height: int) -> None:
        self.model = model
        self.size = width, height
        self._api = api
        self._context = _context(width, height)
        self._context.make_current()
        model.vis.global_.offwidth, model.vis.global_.offheight = self.size
        model.vis.quality.offsamples = 0  # pictures are drawn larger and made smaller, with floor and shadow
        self._drawing = api.MjrContext(model, api.mjtFontScale.mjFONTSCALE_100.value)
        api.mjr_setBuffer(api.mjtFramebuffer.mjFB_OFFSCREEN.value, self._drawing)
        self._scene = api.MjvScene(model, maxgeom=1000)
        self._option = api.MjvOption()
        self._option.geomgroup[:] = DRAWN
        for flag in (api.mjtRndFlag.mjRND_SHADOW, api.mjtRndFlag.mjRND_REFLECTION, api.mjtRndFlag.mjRND_SKYBOX):
            self._scene.flags[flag] = 0

    def __call__(self, data: Any, eye: Eye) -> tuple[NDArray[np.uint8], FloatArray]:
        """As `picture.Renderer`, of the model's state."""
        api, (width, height) = self._api, self.size
        self._context.make_current()
        every = api.mjtCatBit.mjCAT_ALL.value
        api.mjv_updateScene(self.model, data, self._option, None, api.MjvCamera(), every, self._scene)
        edge = eye.near * np.tan(np.radians(eye.field_of_view) / 2)
        for camera in self._scene.camera:  # of both eyes
            camera.pos, camera.forward, camera.up = eye.origin, eye.ahead, eye.up
            camera.frustum_center, camera.frustum_width = 0.0, 0.0  # 0: as the picture's sides demand
            camera.frustum_bottom, camera.frustum_top = -edge, edge
            camera.frustum_near, camera.frustum_far = eye.near, eye.far
        area = api.MjrRect(0, 0, width, height)
        api.mjr_render(area, self._scene, self._drawing)
        colours, depth = np.empty((height, width, 3), np.uint8), np.empty((height, width, 1), np.float32)
        api.mjr_readPixels(colours, depth, area, self._drawing)
        depth = depth[::-1, :, 0]
        away = eye.far * eye.near / (eye.far - (eye.far - eye.near) * depth)
        return colours[::-1], np.where(depth < 1, away, np.float32(np.inf))

    def close(self) -> None:
        self._context.make_current()
        self._drawing.free()
        self._context.free()


def _context(width: int, height: int) -> Any:
    """An OpenGL context. Raises MachineError when the machine offers none."""
    problems = []
    for name in RENDERERS:
        platform = os.environ.pop("PYOPENGL_PLATFORM", None)
        try:
            return import_module(f"mujoco.{name}").GLContext(width, height)
        except (ImportError, AttributeError, OSError, RuntimeError, TypeError) as error:
            problems.append(f"{name}: {error}")
            if platform is not None:
                os.environ["PYOPENGL_PLATFORM"] = platform
    raise MachineError(
        f"MuJoCo finds no OpenGL to draw with ({'; '.join(problems)})",
        hint=RENDERER_HINT,
    )
