"""Bodies and mechanisms made in code, converted to a URDF for the engines. Units: m, rad, kg, kg m2."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import Literal
from xml.etree.ElementTree import Element, SubElement

from ..errors import UsageError
from . import urdf
from .geometry import UPRIGHT, Colour, Quaternion, Vector, matrix_of
from .shapes import Capsule, Cuboid, Cylinder, Inertia, Mesh, Shape, Sphere, inertia_of

GREY: Colour = (0.7, 0.7, 0.7, 1.0)


@dataclass(frozen=True)
class Mechanism:
    """Links and the joints between them. The base is fixed, and moves only by `Body.place`."""

    robot: Element
    """Links and moving joints of a URDF, with absolute names of meshes."""
    frictions: Mapping[str, float] = field(default_factory=dict)
    """Dry friction in N or N m of each joint without a motor."""


@dataclass(frozen=True, kw_only=True)
class Link:
    """A rigid piece of a mechanism made in code. Its joint has the same name.

    Its frame is at `position` and `orientation` in its parent's while the joint is at 0.
    """

    name: str
    shapes: Sequence[Shape]
    mass: float = 0.0
    """Mass in kg. The base needs none."""
    inertia: Inertia | None = None
    colour: Colour = GREY
    parent: str = ""
    """Parent link; empty for the base."""
    joint: Literal["slide", "hinge"] = "slide"
    axis: Vector = (1.0, 0.0, 0.0)
    """Axis of the joint, through the origin of its frame."""
    range: tuple[float, float] = (0.0, 0.0)
    """Range of the joint, in m or rad."""
    friction: float = 0.0
    """Dry friction of the joint in N or N m."""
    damping: float = 0.0
    """Viscous friction of the joint in N s/m or N m s/rad."""
    position: Vector = (0.0, 0.0, 0.0)
    orientation: Quaternion = UPRIGHT


def body(shapes: Sequence[Shape], mass: float, inertia: Inertia | None = None) -> Element:
    """A <robot> of one link.

    Args:
        mass: in kg, 0 for a fixed body.
        inertia: by default that of a body with uniform density.

    Raises UsageError for a mass or an inertia that no body has.
    """
    _check("body", mass, inertia)
    robot = Element("robot", name="body")
    robot.append(link_element("body", shapes, mass, inertia, None))
    return robot


def mechanism(links: Sequence[Link]) -> Mechanism:
    """Check links made in code, the base first. Raises UsageError for a link whose joint, parent or mass is invalid."""
    if not links:
        raise UsageError("a mechanism without links", hint="the base first")
    robot, known = Element("robot", name=links[0].name), set[str]()
    for link in links:
        if link.name in known:
            raise UsageError(f"two links are called {link.name}", hint="a joint has the name of the link that it moves")
        _check(f"link {link.name}", link.mass, link.inertia)
        robot.append(link_element(link.name, link.shapes, link.mass, link.inertia, link.colour))
        low, high = link.range
        moves = link.parent in known and link.mass > 0 and low < high and any(link.axis)
        if known and not (moves and link.joint in ("slide", "hinge") and min(link.friction, link.damping) >= 0):
            hint = "a parent before it, mass > 0, slide or hinge, range with low < high, an axis, no negative friction"
            raise UsageError(f"link {link.name} cannot move", hint=hint)
        if known:
            joint = SubElement(robot, "joint", name=link.name, type={"slide": "prismatic"}.get(link.joint, "revolute"))
            place_element(joint, link.position, link.orientation)
            SubElement(joint, "parent", link=link.parent)
            SubElement(joint, "child", link=link.name)
            SubElement(joint, "axis", xyz=_text(link.axis))
            SubElement(joint, "limit", lower=repr(low), upper=repr(high), effort="1000", velocity="1000")
            SubElement(joint, "dynamics", damping=repr(link.damping))
        known.add(link.name)
    return Mechanism(robot, {link.name: link.friction for link in links[1:]})


def _check(name: str, mass: float, inertia: Inertia | None) -> None:
    """Refuse a mass that is negative or no number, and moments that no body has, which engines treat differently."""
    if not 0 <= mass < inf:
        raise UsageError(f"{name}: a mass of {mass:g} kg", hint="a number > 0, or 0 if it is fixed")
    least, middle, most = sorted(inertia.moments) if inertia is not None and mass else (1.0, 1.0, 1.0)
    if not (least > 0 and most <= 1.001 * (least + middle) < inf):
        hint = "each is > 0, and none is larger than the sum of the others"
        raise UsageError(f"{name}: no body has the moments {least:g} {middle:g} {most:g} kg m2", hint=hint)


def link_element(
    name: str, shapes: Sequence[Shape], mass: float, inertia: Inertia | None, look: Colour | None
) -> Element:
    """A <link>. `inertia`: by default that of a body with uniform density; `look`: None to draw only meshes."""
    link = Element("link", name=name)
    found = inertia or (inertia_of(shapes, mass) if shapes and mass else Inertia((0.0, 0.0, 0.0), (mass, mass, mass)))
    inertial = SubElement(link, "inertial")
    place_element(inertial, found.centre, found.axes)
    SubElement(inertial, "mass", value=repr(mass))
    moments = dict(zip(("ixx", "iyy", "izz"), map(repr, found.moments), strict=True))
    SubElement(inertial, "inertia", moments | dict.fromkeys(("ixy", "ixz", "iyz"), "0"))
    for shape in shapes:
        solid = [_mesh(one, shape.scale) for one in shape.pieces()] if isinstance(shape, Mesh) else [_geometry(shape)]
        kinds = [("collision", one) for one in solid]
        if look is not None or isinstance(shape, Mesh):
            kinds.append(("visual", _geometry(shape)))
        for kind, geometry in kinds:
            made = SubElement(link, kind)
            place_element(made, shape.position, shape.orientation)
            SubElement(made, "geometry").append(geometry)
            if look is not None and kind == "visual":
                SubElement(SubElement(made, "material", name=f"{name} {_text(look)}"), "color", rgba=_text(look))
    return link


def _mesh(path: Path, scale: float | Vector) -> Element:
    return Element("mesh", filename=str(path), scale=_text(scale if isinstance(scale, tuple) else [scale] * 3))


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
        case Mesh(path=path, scale=scale):
            return _mesh(path, scale)
    raise TypeError(f"not a shape: {shape!r}")


def place_element(element: Element, position: Vector, orientation: Quaternion) -> None:
    """Give an element an <origin>."""
    SubElement(element, "origin", xyz=_text(position), rpy=_text(urdf.roll_pitch_yaw(matrix_of(orientation))))


def _text(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)
