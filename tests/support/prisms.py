"""Meshes of parts: an L and a block with a square hole, as somebody's CAD would write them."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from karolos.simulation.meshes import stl

Point = tuple[float, float]
L: tuple[Point, ...] = ((0, 0), (60, 0), (60, 20), (20, 20), (20, 60), (0, 60))
"""Outline of an L of 60 mm with legs of 20 mm."""


def _walls(outline: Sequence[Point], height: float) -> list[list[tuple[float, float, float]]]:
    made = []
    for (a, b), (c, d) in pairwise([*outline, outline[0]]):
        made += [[(a, b, 0), (c, d, 0), (c, d, height)], [(a, b, 0), (c, d, height), (a, b, height)]]
    return made


def prism(path: Path, outline: Sequence[Point], height: float) -> Path:
    """Write an STL of an outline, counter-clockwise and seen from its first corner, `height` high."""
    made = _walls(outline, height)
    for (a, b), (c, d) in pairwise(outline[1:]):
        made += [
            [(*outline[0], height), (a, b, height), (c, d, height)],
            [(*outline[0], 0), (c, d, 0), (a, b, 0)],
        ]
    path.write_bytes(stl(np.array(made, np.float32)))
    return path


def block_with_hole(path: Path, edge: float, hole: float, height: float) -> Path:
    """Write an STL of a square block with a square hole through it."""
    around = [(1, 1), (-1, 1), (-1, -1), (1, -1)]
    outer, inner = ([(x * size / 2, y * size / 2) for x, y in around] for size in (edge, hole))
    made = _walls(outer, height) + _walls(inner[::-1], height)
    for (a, b), (c, d) in zip(pairwise([*outer, outer[0]]), pairwise([*inner, inner[0]]), strict=True):
        for z, order in ((height, 1), (0.0, -1)):
            made += [[(*one, z) for one in (a, b, d)][::order], [(*one, z) for one in (a, d, c)][::order]]
    path.write_bytes(stl(np.array(made, np.float32)))
    return path
