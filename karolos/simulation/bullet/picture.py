"""Pictures of a world: PyBullet's software renderer draws the bodies, NumPy the floor, the shadow and the markers.

The renderer's own floor and shadows take four fifths of its time. Here the floor is a plane with lines every 0.1 and
0.5 m, and the shadow falls straight down, so that heights can be read. The renderer needs no display and has no
antialiasing.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import radians, tan
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...core import Array, FloatArray
from ..geometry import Vector
from ..interface.engine import Camera, Colour

FLOOR_COLOUR = (158.0, 173.0, 189.0)
SKY_COLOUR = (226.0, 232.0, 238.0)
GRIDS = ((0.1, 0.001, 0.3), (0.5, 0.002, 0.55))
"""Distance between lines (m), half their width (m), opacity."""
GRID_COLOUR = (235.0, 239.0, 243.0)
SHADOW = 0.42
"""Opacity of the shadow of a body."""
MARKER_SHADOW = 0.16
MARKER_OPACITY = 0.55
NEAR, FAR = 0.1, 20.0
CELLS = 320
"""The shadow is a square of so many cells to a side."""
ABOVE = 30.0
"""Height from which the shadow is taken, in m: light falls nearly straight down."""


class Marker(NamedTuple):
    """A translucent sphere that is not a body."""

    position: Vector
    radius: float
    """In m."""
    colour: Colour


class View(NamedTuple):
    """What a camera sees of an empty world; height h, width w."""

    origin: FloatArray
    """Of the camera: (3,)."""
    axes: FloatArray
    """To the right, up and ahead: (3, 3)."""
    edge: float
    """Half the picture's height, 1 m ahead."""
    rays: FloatArray
    """Through each pixel, 1 m long along the axis of the camera: (h, w, 3)."""
    matrix: Sequence[float]
    projection: Sequence[float]
    empty: NDArray[np.uint8]
    """The floor and the sky: (h, w, 3)."""
    above: tuple[Sequence[float], Sequence[float]]
    """View and projection matrix of the light."""
    centre: tuple[float, float]
    half: float
    """Half the edge of the square that can have a shadow, in m."""
    cell: Array
    """Index of each pixel's cell in the square: (h, w). Pixels beside it have an index of the border."""


@lru_cache(maxsize=4)
def view_of(api: Any, width: int, height: int, camera: Camera) -> View:
    matrix = api.computeViewMatrixFromYawPitchRoll(camera.target, camera.distance, camera.yaw, camera.pitch, 0.0, 2)
    projection = api.computeProjectionMatrixFOV(camera.field_of_view, width / height, NEAR, FAR)
    turn = np.reshape(matrix, (4, 4)).T
    right, up, back = turn[:3, :3]
    origin = -turn[:3, :3].T @ turn[:3, 3]
    edge = tan(radians(camera.field_of_view) / 2)
    across = (2 * (np.arange(width) + 0.5) / width - 1) * edge * width / height
    down = (1 - 2 * (np.arange(height) + 0.5) / height) * edge
    rays = across[None, :, None] * right + down[:, None, None] * up - back
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
    light = api.computeViewMatrix((*centre, ABOVE), (*centre, 0.0), (0.0, 1.0, 0.0))
    angle = 2 * np.degrees(np.arctan(half / ABOVE))
    columns, rows = (
        np.clip(((sign * (place - middle) / half + 1) / 2 * CELLS).astype(np.int64), 0, CELLS - 1)
        for sign, place, middle in ((1, x, centre[0]), (-1, y, centre[1]))
    )
    return View(
        origin.astype(np.float32),
        np.array([right, up, -back], np.float32),
        edge,
        rays.astype(np.float32),
        matrix,
        projection,
        empty.astype(np.uint8),
        (light, api.computeProjectionMatrixFOV(angle, 1.0, ABOVE - 4, ABOVE + 1)),
        centre,
        half,
        (rows * CELLS + columns).astype(np.int32),
    )


def draw(api: Any, client: int, width: int, height: int, camera: Camera, markers: Sequence[Marker]) -> Array:
    """A picture (height, width, 3) uint8."""
    view = view_of(api, width, height, camera)
    image = api.getCameraImage(
        width,
        height,
        view.matrix,
        view.projection,
        lightDirection=(1.5, -1.4, 3.0),
        lightColor=(1.0, 0.99, 0.97),
        lightAmbientCoeff=0.52,
        lightDiffuseCoeff=0.4,
        lightSpecularCoeff=0.05,
        shadow=0,
        renderer=api.ER_TINY_RENDERER,
        physicsClientId=client,
    )
    seen = np.asarray(image[4]).reshape(height, width) >= 0
    picture = view.empty.copy()
    shade = _shadow(api, client, view, markers).ravel()[view.cell]
    dark = np.nonzero((shade > 0) & ~seen)
    picture[dark] = picture[dark] * (1 - shade[dark])[:, None]
    np.copyto(picture, np.asarray(image[2], np.uint8).reshape(height, width, 4)[..., :3], where=seen[..., None])
    if markers:
        buffer = np.asarray(image[3], np.float32).reshape(height, width)
        away = np.where(seen, FAR * NEAR / (FAR - (FAR - NEAR) * buffer), np.float32(np.inf))
        for marker in markers:
            _draw_marker(picture, view, away, marker)
    return picture


def _shadow(api: Any, client: int, view: View, markers: Sequence[Marker]) -> FloatArray:
    """Opacity of the shadow in each cell of the square, seen from above: (CELLS, CELLS)."""
    image = api.getCameraImage(
        CELLS, CELLS, *view.above, shadow=0, renderer=api.ER_TINY_RENDERER, physicsClientId=client
    )
    shadow = SHADOW * (np.asarray(image[4]).reshape(CELLS, CELLS) >= 0).astype(np.float32)
    size = 2 * view.half / CELLS
    for marker in markers:
        x = view.centre[0] - view.half + (np.arange(CELLS) + 0.5) * size - marker.position[0]
        y = view.centre[1] + view.half - (np.arange(CELLS) + 0.5) * size - marker.position[1]
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
    offset = np.array(marker.position, np.float32) - view.origin
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
    place = np.nonzero((beside > 0) & (depth > NEAR) & (depth < away[part]))
    normal_z = (depth[place] * rays[place][:, 2] - offset[2]) / marker.radius
    colour = 255 * np.array(marker.colour[:3], np.float32) * (0.85 + 0.15 * normal_z[:, None])
    picture[part][place] = picture[part][place] * (1 - MARKER_OPACITY) + MARKER_OPACITY * colour
