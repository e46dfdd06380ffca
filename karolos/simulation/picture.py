"""Pictures of a world: the engine's renderer draws the bodies, NumPy the floor, the shadow, markers and strokes.

Pictures therefore look the same in every engine. In PyBullet they take a fifth of the time, because its own floor and
shadows are slow. The floor is a plane with lines every 0.1 and 0.5 m and a plate under the arm. The shadow falls
straight down and shows heights. Pictures are drawn larger and scaled down, which smooths edges.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from math import atan, cos, degrees, hypot, pi, radians, sin, tan
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core import Array, FloatArray
from .geometry import Colour, Vector, vector
from .interface import Camera, Stroke

SAMPLES = 2
"""Number of samples along each side of a pixel; the pixel is their mean."""
FLOOR_COLOUR = (158.0, 173.0, 189.0)
SKY_COLOUR = (226.0, 232.0, 238.0)
PLATE_COLOUR, PLATE_EDGE = (122.0, 134.0, 147.0), (84.0, 94.0, 105.0)
PLATE = (-0.4, 0.9, 0.55)
"""The plate under the arm: its front and back end, and half its width, in m from the arm's base."""
PLATE_CORNER, PLATE_RIM, PLATE_SHADOW = 0.06, 0.012, 0.05
"""Radius of its corners, width of its rim and of the shadow around it, in m."""
GRIDS = ((0.1, 0.0008, 0.22), (0.5, 0.0015, 0.4))
"""Distance between lines (m), half their width (m), opacity."""
GRID_COLOUR = (235.0, 239.0, 243.0)
SHADOW_OPACITY = 0.42
"""Opacity of the shadow of a body."""
MARKER_OPACITY = 0.5
STROKE = 0.006
"""Width of a stroke as a fraction of the picture's height."""
PIECES = 4
"""Number of pieces of a line between two points; a body hides a piece as a whole."""
SHADOW_CELLS = 160, 480
"""Smallest and largest number of cells along a side of the shadow's square; usually the picture's height."""
LIGHT_HEIGHT = 30.0
"""Height of the light, in m: it falls nearly straight down."""


class Eye(NamedTuple):
    """A pinhole camera."""

    origin: Vector
    ahead: Vector
    """Unit vector."""
    up: Vector
    """Unit vector, perpendicular to `ahead`."""
    field_of_view: float
    """Vertical angle of view, in degrees."""
    near: float = 0.1
    far: float = 20.0
    """The camera sees only bodies between these distances ahead, in m."""


Renderer = Callable[[Eye, int, int], tuple[NDArray[np.uint8], FloatArray]]
"""Draws the bodies for an eye, a width and a height: colours (height, width, 3) and the distance ahead in m (height,
width), which is infinite without a body."""


class Marker(NamedTuple):
    """A place without a body: a translucent sphere in a ring with a line down to the floor, or a disc on the floor."""

    position: Vector
    radius: float
    """Radius in m."""
    colour: Colour

    @property
    def lies(self) -> bool:
        """Whether it touches the floor. There a disc is clearer than a part of a sphere."""
        return self.position[2] <= self.radius


class View(NamedTuple):
    """The view of an empty world; height h, width w."""

    eye: Eye
    axes: FloatArray
    """Unit vectors to the right, up and ahead: (3, 3)."""
    edge: float
    """Half the picture's height at a distance of 1 m."""
    rays: FloatArray
    """Rays through each pixel, 1 m long along the axis of the camera: (h, w, 3)."""
    empty: NDArray[np.uint8]
    """Picture of the floor and the sky: (h, w, 3)."""
    floor: FloatArray
    """x and y of the floor in each pixel, in m: (h, w, 2)."""
    above: Eye
    """Eye of the light."""
    cells: int
    """Number of cells along a side of the square that can have a shadow."""
    cell: Array
    """Index of each pixel's cell in the square: (h, w). Pixels outside it have an index of the border."""


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
    empty = _plate(x - camera.base[0], y - camera.base[1])
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
    cells = min(max(height // SAMPLES, SHADOW_CELLS[0]), SHADOW_CELLS[1])
    columns, rows = (
        np.clip(((sign * (place - middle) / half + 1) / 2 * cells).astype(np.int64), 0, cells - 1)
        for sign, place, middle in ((1, x, centre[0]), (-1, y, centre[1]))
    )
    angle, near, far = degrees(2 * atan(half / LIGHT_HEIGHT)), LIGHT_HEIGHT - 4, LIGHT_HEIGHT + 1
    return View(
        Eye(vector(origin), vector(ahead), vector(up), camera.field_of_view),
        np.array([right, up, ahead], np.float32),
        edge,
        rays.astype(np.float32),
        empty.astype(np.uint8),
        np.stack((x, y), -1).astype(np.float32),
        Eye((*centre, LIGHT_HEIGHT), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0), angle, near, far),
        cells,
        (rows * cells + columns).astype(np.int32),
    )


def _plate(x: Array, y: Array) -> Array:
    """The floor with the plate, for places (h, w) in m from the arm's base: colours (h, w, 3)."""
    behind, ahead, half = PLATE
    along = np.abs(x - (behind + ahead) / 2) - (ahead - behind) / 2 + PLATE_CORNER
    across = np.abs(y) - half + PLATE_CORNER
    beyond = np.hypot(np.maximum(along, 0), np.maximum(across, 0)) + np.minimum(np.maximum(along, across), 0)
    outside = (beyond - PLATE_CORNER)[..., None]  # distance from its edge in m, negative on the plate
    shaded = np.array(FLOOR_COLOUR) * (1 - SHADOW_OPACITY * np.exp(-((outside / PLATE_SHADOW) ** 2)))
    return np.where(outside > 0, shaded, np.where(outside > -PLATE_RIM, PLATE_EDGE, PLATE_COLOUR))


def draw(
    render: Renderer, width: int, height: int, camera: Camera, markers: Sequence[Marker], strokes: Sequence[Stroke]
) -> Array:
    """A picture (height, width, 3) uint8."""
    from PIL import Image  # noqa: PLC0415

    size = SAMPLES * width, SAMPLES * height
    view = view_of(*size, camera)
    colours, away = render(view.eye, *size)
    seen = np.isfinite(away)
    picture = view.empty.copy()
    rings = [ring for marker in markers for ring in _rings(marker, view)]
    for marker in markers:
        if marker.lies:
            place = np.nonzero(
                ((view.floor - np.array(marker.position[:2], np.float32)) ** 2).sum(-1) < marker.radius**2
            )
            _blend(picture, place, 255 * np.array(marker.colour[:3], np.float32))
    shade = _shadow(render, view).ravel()[view.cell]
    dark = np.nonzero((shade > 0) & ~seen)
    picture[dark] = picture[dark] * (1 - shade[dark])[:, None]
    np.copyto(picture, colours, where=seen[..., None])
    for marker in markers:
        if not marker.lies:
            _draw_sphere(picture, view, away, marker)
    if rings or strokes:
        picture = _draw_strokes(picture, view, away, [*rings, *strokes])
    return np.asarray(Image.fromarray(picture).reduce(SAMPLES))


def _blend(picture: NDArray[np.uint8], place: tuple[Array, ...], colour: Array) -> None:
    picture[place] = picture[place] * (1 - MARKER_OPACITY) + MARKER_OPACITY * colour


def _shadow(render: Renderer, view: View) -> FloatArray:
    """Opacity of the shadow in each cell of the square, seen from above: (cells, cells)."""
    _, below = render(view.above, view.cells, view.cells)
    shadow = SHADOW_OPACITY * np.isfinite(below).astype(np.float32)
    for _ in range(4):  # a soft edge
        shadow[1:-1] = (shadow[:-2] + shadow[1:-1] + shadow[2:]) / 3
        shadow[:, 1:-1] = (shadow[:, :-2] + shadow[:, 1:-1] + shadow[:, 2:]) / 3
    shadow[[0, -1]] = 0
    shadow[:, [0, -1]] = 0
    return shadow


def _rings(marker: Marker, view: View) -> Iterator[Stroke]:
    """The outlines of a marker: on the floor, or facing the camera with a line down to the floor."""
    (x, y, z), radius, colour = marker
    turn = np.linspace(0.0, 2 * pi, 49)
    circle = radius * np.stack((np.cos(turn), np.sin(turn), np.zeros(49)), -1)
    floor = np.array((x, y, 0.001))
    if marker.lies:
        ring = circle + floor
    else:
        ring = circle @ view.axes + np.array(marker.position)
        yield Stroke(((x, y, z - radius), (x, y, 0.001)), colour, width=0.4)
        below = circle / 3 + floor
        yield Stroke(tuple(map(vector, below)), colour, width=0.6)
    yield Stroke(tuple(map(vector, ring)), colour)


def _draw_strokes(
    picture: NDArray[np.uint8], view: View, away: FloatArray, strokes: Sequence[Stroke]
) -> NDArray[np.uint8]:
    """The picture with strokes, which bodies in front hide, and arrows, which nothing hides."""
    from PIL import Image, ImageDraw  # noqa: PLC0415

    image = Image.fromarray(picture)
    drawing = ImageDraw.Draw(image)
    height, width = picture.shape[:2]
    for stroke in strokes:
        if len(stroke.points) < 2:
            continue
        colour = tuple(round(255 * level) for level in stroke.colour[:3])
        thick = max(1, round(stroke.width * STROKE * height))
        last = len(stroke.points) - 1
        places = np.linspace(0, last, 1 + PIECES * last)
        points = np.stack([np.interp(places, range(last + 1), axis) for axis in np.transpose(stroke.points)], -1)
        right, up, ahead = (view.axes @ (points - np.array(view.eye.origin)).T).astype(float)
        ahead = np.maximum(ahead, view.eye.near)
        scale = height / 2 / view.edge / ahead
        across, down = width / 2 + right * scale, height / 2 - up * scale
        ends = list(zip(across.tolist(), down.tolist(), strict=True))
        if stroke.label is None:
            columns, rows = (np.clip(at, 0, end - 1).astype(int) for at, end in ((across, width), (down, height)))
            shown = away[rows, columns] > ahead - 0.004
            for first, second, visible in zip(ends, ends[1:], (shown[1:] & shown[:-1]).tolist(), strict=False):
                if visible:
                    drawing.line((first, second), fill=colour, width=thick)
        else:
            _draw_arrow(drawing, ends[0], ends[-1], thick, colour, stroke.label)
    return np.asarray(image)


def _draw_arrow(
    drawing: Any, start: tuple[float, float], end: tuple[float, float], thick: int, colour: Any, label: str
) -> None:
    """An arrow between two places in the picture, with a white edge; the label stands right of its head."""
    from PIL import ImageFont  # noqa: PLC0415

    (x, y), (end_x, end_y) = start, end
    long = max(hypot(end_x - x, end_y - y), 1e-6)
    a, b = (end_x - x) / long, (end_y - y) / long
    head = min(4.0 * thick, long)
    neck = end_x - a * head, end_y - b * head
    half = [(start, 0.5), (neck, 0.5), (neck, 1.6), (end, 0.0)]  # places and how far the edge is from them
    edge = [(px - side * b * w * thick, py + side * a * w * thick) for side in (1, -1) for (px, py), w in half[::side]]
    drawing.polygon(edge, fill=colour, outline="white", width=max(1, thick // 4))
    font, white = ImageFont.load_default(5.5 * thick), {"stroke_width": max(1, thick // 4), "stroke_fill": "white"}
    drawing.text((end_x + 2 * thick, end_y), label, fill=colour, font=font, anchor="lm", **white)


def _draw_sphere(picture: NDArray[np.uint8], view: View, away: FloatArray, marker: Marker) -> None:
    """Blend a sphere into the picture, except behind bodies. `away`: depth of the bodies in m."""
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
    _blend(picture[part], place, colour)
