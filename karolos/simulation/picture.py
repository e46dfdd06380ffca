"""Pictures of a world: the engine's renderer draws the bodies, NumPy the floor, the shadow and the markers.

So pictures look alike whatever the engine, and cost a fifth with PyBullet, whose own floor and shadows are slow. The
floor is a plane with lines every 0.1 and 0.5 m, and the shadow falls straight down, so that heights can be read.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from math import atan, cos, degrees, radians, sin, tan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core import Array, FloatArray
from .geometry import Colour, Vector
from .interface.engine import Camera

FLOOR_COLOUR = (158.0, 173.0, 189.0)
SKY_COLOUR = (226.0, 232.0, 238.0)
GRIDS = ((0.1, 0.001, 0.3), (0.5, 0.002, 0.55))
"""Distance between lines (m), half their width (m), opacity."""
GRID_COLOUR = (235.0, 239.0, 243.0)
SHADOW_OPACITY = 0.42
"""Opacity of the shadow of a body."""
MARKER_SHADOW = 0.16
MARKER_OPACITY = 0.55
SHADOW_CELLS = 320
"""The shadow is a square of so many cells to a side."""
LIGHT_HEIGHT = 30.0
"""Height from which the shadow is taken, in m: light falls nearly straight down."""


class Eye(NamedTuple):
    """A pinhole camera."""

    origin: Vector
    ahead: Vector
    """Unit vector."""
    up: Vector
    """Unit vector, perpendicular to `ahead`."""
    field_of_view: float
    """Vertical, in degrees."""
    near: float = 0.1
    far: float = 20.0
    """Only what lies between these distances ahead, in m, is seen."""


Renderer = Callable[[Eye, int, int], tuple[NDArray[np.uint8], FloatArray]]
"""Draws the bodies for an eye, a width and a height: colours (height, width, 3) and the distance ahead in m (height,
width), which is infinite where there is no body."""


class Marker(NamedTuple):
    """A translucent sphere that is not a body."""

    position: Vector
    radius: float
    """In m."""
    colour: Colour


class View(NamedTuple):
    """What a camera sees of an empty world; height h, width w."""

    eye: Eye
    axes: FloatArray
    """To the right, up and ahead: (3, 3)."""
    edge: float
    """Half the picture's height, 1 m ahead."""
    rays: FloatArray
    """Through each pixel, 1 m long along the axis of the camera: (h, w, 3)."""
    empty: NDArray[np.uint8]
    """The floor and the sky: (h, w, 3)."""
    above: Eye
    """The light."""
    centre: tuple[float, float]
    half: float
    """Half the edge of the square that can have a shadow, in m."""
    cell: Array
    """Index of each pixel's cell in the square: (h, w). Pixels beside it have an index of the border."""


@lru_cache(maxsize=4)
def view_of(width: int, height: int, camera: Camera) -> View:
    yaw, pitch = radians(camera.yaw), radians(camera.pitch)
    ahead = np.array([-sin(yaw) * cos(pitch), cos(yaw) * cos(pitch), sin(pitch)])
    right = np.array([cos(yaw), sin(yaw), 0.0])
    up = np.cross(right, ahead)
    origin = np.array(camera.target) - camera.distance * ahead
    edge = tan(radians(camera.field_of_view) / 2)
    across = (2 * (np.arange(width) + 0.5) / width - 1) * edge * width / height
    down = (1 - 2 * (np.arange(height) + 0.5) / height) * edge
    rays = across[None, :, None] * right + down[:, None, None] * up + ahead
    falls = rays[..., 2] < -1e-3
    away = np.where(falls, -origin[2] / np.minimum(rays[..., 2], -1e-3), 1e3)
    x, y = origin[0] + away * rays[..., 0], origin[1] + away * rays[..., 1]
    empty = np.broadcast_to(np.array(FLOOR_COLOUR), (height, width, 3)).copy()
    for spacing, half, opacity in GRIDS:
        for place in (x, y):
            pixel = sum(np.abs(np.gradient(place, axis=axis)) for axis in (0, 1)) + 1e-6
            distance = np.abs(place - spacing * np.round(place / spacing))
            covered = np.clip((half + pixel / 2 - distance) / pixel, 0, 1) * np.clip(1.5 - 3 * pixel / spacing, 0, 1)
            empty += (opacity * covered)[..., None] * (np.array(GRID_COLOUR) - empty)
    fog = np.exp(-((away / (3.2 * camera.distance)) ** 2)) * falls
    empty = fog[..., None] * empty + (1 - fog)[..., None] * np.array(SKY_COLOUR)
    half = 0.8 * camera.distance
    centre = (camera.target[0], camera.target[1])
    columns, rows = (
        np.clip(((sign * (place - middle) / half + 1) / 2 * SHADOW_CELLS).astype(np.int64), 0, SHADOW_CELLS - 1)
        for sign, place, middle in ((1, x, centre[0]), (-1, y, centre[1]))
    )
    return View(
        Eye(_vector(origin), _vector(ahead), _vector(up), camera.field_of_view),
        np.array([right, up, ahead], np.float32),
        edge,
        rays.astype(np.float32),
        empty.astype(np.uint8),
        Eye(
            (*centre, LIGHT_HEIGHT),
            (0.0, 0.0, -1.0),
            (0.0, 1.0, 0.0),
            degrees(2 * atan(half / LIGHT_HEIGHT)),
            LIGHT_HEIGHT - 4,
            LIGHT_HEIGHT + 1,
        ),
        centre,
        half,
        (rows * SHADOW_CELLS + columns).astype(np.int32),
    )


def _vector(values: Array) -> Vector:
    x, y, z = values.tolist()
    return x, y, z


def draw(render: Renderer, width: int, height: int, camera: Camera, markers: Sequence[Marker]) -> Array:
    """A picture (height, width, 3) uint8."""
    view = view_of(width, height, camera)
    colours, away = render(view.eye, width, height)
    seen = np.isfinite(away)
    picture = view.empty.copy()
    shade = _shadow(render, view, markers).ravel()[view.cell]
    dark = np.nonzero((shade > 0) & ~seen)
    picture[dark] = picture[dark] * (1 - shade[dark])[:, None]
    np.copyto(picture, colours, where=seen[..., None])
    for marker in markers:
        _draw_marker(picture, view, away, marker)
    return picture


def _shadow(render: Renderer, view: View, markers: Sequence[Marker]) -> FloatArray:
    """Opacity of the shadow in each cell of the square, seen from above: (SHADOW_CELLS, SHADOW_CELLS)."""
    _, below = render(view.above, SHADOW_CELLS, SHADOW_CELLS)
    shadow = SHADOW_OPACITY * np.isfinite(below).astype(np.float32)
    size = 2 * view.half / SHADOW_CELLS
    for marker in markers:
        x = view.centre[0] - view.half + (np.arange(SHADOW_CELLS) + 0.5) * size - marker.position[0]
        y = view.centre[1] + view.half - (np.arange(SHADOW_CELLS) + 0.5) * size - marker.position[1]
        disc = x[None] ** 2 + y[:, None] ** 2 < marker.radius**2
        shadow[disc] = np.maximum(shadow[disc], MARKER_SHADOW)
    for _ in range(2):  # a soft edge
        shadow[1:-1] = (shadow[:-2] + shadow[1:-1] + shadow[2:]) / 3
        shadow[:, 1:-1] = (shadow[:, :-2] + shadow[:, 1:-1] + shadow[:, 2:]) / 3
    shadow[[0, -1]] = 0
    shadow[:, [0, -1]] = 0
    return shadow


def _draw_marker(picture: NDArray[np.uint8], view: View, away: FloatArray, marker: Marker) -> None:
    """Blend a sphere into the picture where no body is in front of it. `away`: depth of the bodies in m."""
    offset = np.array(marker.position, np.float32) - np.array(view.eye.origin, np.float32)
    right, up, ahead = (view.axes @ offset).tolist()
    if ahead <= marker.radius:
        return
    height, width = picture.shape[:2]
    scale = height / 2 / view.edge / ahead  # pixels per m at the sphere
    reach = 1.5 * marker.radius * scale + 2
    (top, bottom), (left, end) = (
        (int(np.clip(at - reach, 0, size)), int(np.clip(at + reach, 0, size)))
        for at, size in ((height / 2 - up * scale, height), (width / 2 + right * scale, width))
    )
    part = np.s_[top:bottom, left:end]
    rays = view.rays[part]
    along, square = rays @ offset, np.vecdot(rays, rays)
    beside = along**2 - square * (offset @ offset - np.float32(marker.radius) ** 2)
    depth = (along - np.sqrt(np.maximum(beside, 0))) / square
    place = np.nonzero((beside > 0) & (depth > view.eye.near) & (depth < away[part]))
    normal_z = (depth[place] * rays[place][:, 2] - offset[2]) / marker.radius
    colour = 255 * np.array(marker.colour[:3], np.float32) * (0.85 + 0.15 * normal_z[:, None])
    picture[part][place] = picture[part][place] * (1 - MARKER_OPACITY) + MARKER_OPACITY * colour
