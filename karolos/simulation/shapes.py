"""Shapes of bodies, with their volume and inertia. Units: m, kg, kg m2; quaternions x y z w."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from pathlib import Path

import numpy as np

from ..core import Array
from ..errors import UsageError
from . import meshes
from .geometry import UPRIGHT, Quaternion, Vector, matrix_of, quaternion_of

LEAST_SIZE, LARGEST_SIZE = 1e-6, 20.0
"""Smallest and largest edge, radius, length and coordinate of a shape in m, and scale of a mesh."""
_SIZES = ("size", "radius", "length", "scale")


@dataclass(frozen=True, kw_only=True)
class Shape(ABC):
    """A shape with a pose in the frame of its body."""

    position: Vector = (0.0, 0.0, 0.0)
    orientation: Quaternion = UPRIGHT

    def __post_init__(self) -> None:
        for name in ("size", "radius", "length", "scale", "position", "orientation"):
            value, least = getattr(self, name, 1.0), LEAST_SIZE if name in _SIZES else -LARGEST_SIZE
            numbers = np.abs(value) if name == "scale" else np.ravel(value)  # a negative scale mirrors
            if not all(least <= number <= LARGEST_SIZE for number in np.ravel(numbers)):
                what, hint = f"{type(self).__name__}: {name} {value}", f"{least:g} to {LARGEST_SIZE:g} m"
                raise UsageError(what, hint=hint)
        if not any(self.orientation):
            raise UsageError(f"{type(self).__name__}: orientation {self.orientation}", hint="a quaternion x y z w")

    @abstractmethod
    def solid(self) -> tuple[float, Array, Array]:
        """Volume in m3, centre of mass (3,) in the shape's frame, and the inertia (3, 3) about it per kg."""


@dataclass(frozen=True)
class Cuboid(Shape):
    """A box with edges of `size` along its axes."""

    size: Vector

    def solid(self) -> tuple[float, Array, Array]:
        x, y, z = np.square(self.size)
        return float(np.prod(self.size)), np.zeros(3), np.diag([y + z, x + z, x + y]) / 12


@dataclass(frozen=True)
class Sphere(Shape):
    """A ball."""

    radius: float

    def solid(self) -> tuple[float, Array, Array]:
        return 4 / 3 * pi * self.radius**3, np.zeros(3), np.eye(3) * 0.4 * self.radius**2


@dataclass(frozen=True)
class Cylinder(Shape):
    """A cylinder along its z axis."""

    radius: float
    length: float

    def solid(self) -> tuple[float, Array, Array]:
        across = self.radius**2 / 4 + self.length**2 / 12
        return pi * self.radius**2 * self.length, np.zeros(3), np.diag([across, across, self.radius**2 / 2])


@dataclass(frozen=True)
class Capsule(Shape):
    """A cylinder along its z axis with half a ball at each end; `length` is that of the cylinder."""

    radius: float
    length: float

    def solid(self) -> tuple[float, Array, Array]:
        radius, length = self.radius, self.length
        middle, _, cylinder = Cylinder(radius, length).solid()
        ends, _, ball = Sphere(radius).solid()
        away = length**2 / 4 + 3 / 8 * length * radius  # the distance of the half balls' centres
        tensor = middle * cylinder + ends * (ball + np.diag([away, away, 0.0]))
        return middle + ends, np.zeros(3), tensor / (middle + ends)


@dataclass(frozen=True)
class Mesh(Shape):
    """A part from an STL, OBJ or Collada file, multiplied by `scale`: with .001 the file is in millimetres.

    `scale` may have a factor for each axis; a negative one mirrors the part.

    Mass and inertia follow from the enclosed volume or, with a warning, from the convex hull. Collision shapes are
    convex. For a mesh that is not convex, `collision` chooses its convex hull, or the convex pieces that the package
    coacd finds (`pip install 'karolos[parts]'`). The pieces follow the mesh to about 2 % of its size. This is too
    coarse for a peg in a hole: make such a hole from boxes.

    Raises PluginError for a file that is not a mesh, for a flat part, and for a part smaller than .1 mm or larger than
    5 m.
    """

    path: Path
    scale: float | Vector = 1.0
    collision: meshes.Collision | None = None
    """None: convex hull, with a warning if it fills a hole or a hollow."""

    def __post_init__(self) -> None:
        super().__post_init__()
        meshes.check_size(self.path, self.scale)
        meshes.warn_of_hull(self.path, weighed=True, accepted=self.collision is not None)

    def solid(self) -> tuple[float, Array, Array]:
        volume, centre, tensor, *_ = meshes.solid(self.path)
        scale = np.broadcast_to(self.scale, 3)
        moments = np.trace(tensor) / 2 * np.eye(3) - tensor  # means of x x, x y, ...
        moments = scale[:, None] * moments * scale
        return volume * abs(float(np.prod(scale))), centre * scale, np.trace(moments) * np.eye(3) - moments

    def pieces(self) -> tuple[Path, ...]:
        """Files of the convex pieces, in the unit of the file."""
        return meshes.pieces(self.path) if self.collision == "decomposed" else (self.path,)


@dataclass(frozen=True)
class Inertia:
    """Inertia of a body: centre of mass, principal moments in kg m2, and their axes, in the body's frame."""

    centre: Vector
    moments: Vector
    axes: Quaternion = UPRIGHT


def volume_of(shapes: Sequence[Shape]) -> float:
    """Volume of all shapes in m3. Overlaps count twice."""
    return sum(shape.solid()[0] for shape in shapes)


def inertia_of(shapes: Sequence[Shape], mass: float) -> Inertia:
    """Inertia of a body of `mass` kg with uniform density."""
    solids = []
    for shape in shapes:
        volume, middle, tensor = shape.solid()
        turn = matrix_of(shape.orientation)
        solids.append((volume, np.array(shape.position) + turn @ middle, turn @ tensor @ turn.T))
    total = sum(volume for volume, _, _ in solids)
    centre = sum((volume * middle for volume, middle, _ in solids), np.zeros(3)) / total
    tensor = np.zeros((3, 3))
    for volume, middle, own in solids:
        offset = middle - centre
        tensor += mass * volume / total * (own + offset @ offset * np.eye(3) - np.outer(offset, offset))
    moments, axes = np.diag(tensor), np.eye(3)
    if np.abs(tensor - np.diag(moments)).max() > 1e-9 * moments.max():
        moments, axes = np.linalg.eigh(tensor)
        axes *= np.sign(np.linalg.det(axes))
    x, y, z = centre.tolist()
    a, b, c = moments.tolist()
    return Inertia((x, y, z), (a, b, c), quaternion_of(axes))
