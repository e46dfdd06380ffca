"""Writes parts/plug.stl and parts/plate.stl in millimetres, as a CAD would: python -m karolos_assembly.make_parts

The plug is 24 x 16 x 60 mm. One corner is cut off, so it fits in one orientation only. Its tip has a chamfer of 1 mm.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from karolos.simulation.meshes import stl

Outline = list[tuple[float, float]]


def plug_outline(inset: float) -> Outline:
    """The plug from above, counter-clockwise, each side `inset` mm further in."""
    x, y, cut = 12 - inset, 8 - inset, 15 - inset * 2**0.5
    return [(-x, -y), (x, -y), (x, cut - x), (cut - y, y), (-x, y)]


def solid(layers: list[tuple[float, Outline]]) -> bytes:
    """The STL of outlines at growing heights in mm, with a wall from each to the next."""
    triangles = []
    for (low, below), (high, above) in pairwise(layers):
        for (a, b), (c, d) in zip(pairwise([*below, below[0]]), pairwise([*above, above[0]]), strict=True):
            triangles += [[(*a, low), (*b, low), (*d, high)], [(*a, low), (*d, high), (*c, high)]]
    for (height, outline), order in ((layers[0], -1), (layers[-1], 1)):
        for b, c in pairwise(outline[1:]):
            triangles.append([(*point, height) for point in (outline[0], b, c)][::order])
    return stl(np.array(triangles, np.float32))


def parts() -> dict[str, bytes]:
    """The files by name."""
    corners = [(45, 30), (35, 40), (-35, 40), (-45, 30), (-45, -30), (-35, -40), (35, -40), (45, -30)]
    plate: Outline = [(float(x), float(y)) for x, y in corners]
    plug = [(0.0, plug_outline(1)), (1.0, plug_outline(0)), (60.0, plug_outline(0))]
    return {"plug.stl": solid(plug), "plate.stl": solid([(0.0, plate), (5.0, plate)])}


if __name__ == "__main__":
    for name, data in parts().items():
        (Path(__file__).parent / "parts" / name).write_bytes(data)
