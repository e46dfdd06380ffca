"""Descriptions made in code: links of shapes as a URDF has them. Units: m, kg, kg m2."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

from .geometry import Quaternion, Vector, matrix_of
from .shapes import Capsule, Cuboid, Cylinder, Inertia, Mesh, Shape, Sphere, inertia_of
from .urdf import roll_pitch_yaw


def body(shapes: Sequence[Shape], mass: float, inertia: Inertia | None = None) -> Element:
    """A <robot> of one link.

    Args:
        shapes: of which the link consists.
        mass: in kg, 0 for one that does not move.
        inertia: by default that of a body as dense everywhere.
    """
    robot = Element("robot", name="body")
    robot.append(_link("body", shapes, mass, inertia))
    return robot


def _link(name: str, shapes: Sequence[Shape], mass: float, inertia: Inertia | None) -> Element:
    link = Element("link", name=name)
    found = inertia or inertia_of(shapes, mass)
    inertial = SubElement(link, "inertial")
    _place(inertial, found.centre, found.axes)
    SubElement(inertial, "mass", value=repr(mass))
    moments = dict(zip(("ixx", "iyy", "izz"), map(repr, found.moments), strict=True))
    SubElement(inertial, "inertia", moments | dict.fromkeys(("ixy", "ixz", "iyz"), "0"))
    for shape in shapes:
        kinds = [("collision", one) for one in _geometries(shape)]
        if isinstance(shape, Mesh):
            kinds.append(("visual", _mesh(shape.path, shape.scale)))
        for kind, geometry in kinds:
            made = SubElement(link, kind)
            _place(made, shape.position, shape.orientation)
            SubElement(made, "geometry").append(geometry)
    return link


def _geometries(shape: Shape) -> list[Element]:
    """What a shape collides as, in a URDF's words."""
    if isinstance(shape, Mesh):
        return [_mesh(piece, shape.scale) for piece in shape.pieces()]
    return [_geometry(shape)]


def _mesh(path: Path, scale: float) -> Element:
    return Element("mesh", filename=str(path), scale=_text([scale] * 3))


def _geometry(shape: Shape) -> Element:
    match shape:
        case Cuboid(size=size):
            return Element("box", size=_text(size))
        case Sphere(radius=radius):
            return Element("sphere", radius=repr(radius))
        case Cylinder(radius=radius, length=length):
            return Element("cylinder", radius=repr(radius), length=repr(length))
        case Capsule(radius=radius, length=length):
            return Element("capsule", radius=repr(radius), length=repr(length))
    raise TypeError(f"no shape: {shape!r}")


def _place(element: Element, position: Vector, orientation: Quaternion) -> None:
    SubElement(element, "origin", xyz=_text(position), rpy=_text(roll_pitch_yaw(matrix_of(orientation))))


def _text(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)
