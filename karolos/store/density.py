"""Density of the success ratios of several seeds: pure functions of arrays.

The unit between runs is the seed: never pool the episodes of several seeds into one interval.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

GRID_POINTS = 101
"""Number of points of a density over [0, 1]; Simpson's rule needs an odd number."""
SMALLEST_BANDWIDTH = 0.02
"""Smallest bandwidth: two grid steps. The grid cannot show narrower kernels; equal values would give a width of 0."""

_Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Density:
    """A density over [0, 1] of the success ratios of several seeds."""

    grid: _Floats
    """(101,) points from 0 to 1."""
    density: _Floats
    """(101,) non-negative; its integral by Simpson's rule is 1."""
    bandwidth: float
    """Standard deviation of the kernel."""
    mode: float
    """Place of the largest density (the first one of equals)."""
    modes: tuple[float, ...]
    """Every local maximum, in ascending order."""
    mean: float
    low: float
    """5 % of the mass is below."""
    high: float
    """95 % of the mass is below."""


def bandwidth(values: ArrayLike) -> float:
    """Width of the kernel for success ratios (n,): max(.9 min(sd, IQR / 1.34) n^(-1/5), .02).

    Source: Silverman 1986, Density Estimation, equation 3.31, with a floor for seeds that agree.
    """
    ratios = np.asarray(values, np.float64)
    if ratios.size < 2:
        return SMALLEST_BANDWIDTH
    lower, upper = np.quantile(ratios, (0.25, 0.75))
    spread = min(float(ratios.std(ddof=1)), float(upper - lower) / 1.34)
    return max(0.9 * spread * math.pow(ratios.size, -0.2), SMALLEST_BANDWIDTH)


def kde(values: ArrayLike) -> Density:
    """Density of success ratios (n,), each in [0, 1], by Gaussian kernels reflected at 0 and 1.

    Reflection keeps the mass inside [0, 1]. A plain kernel would lose half of the mass of five seeds at 1.0.
    Source of the reflection: Schuster 1985, Comm. Stat. Theory Methods 14, 1123.

    Raises:
        ValueError: there are no values, or one is outside [0, 1].
    """
    ratios = np.asarray(values, np.float64).ravel()
    if ratios.size == 0 or not ((ratios >= 0) & (ratios <= 1)).all():
        raise ValueError("a density needs success ratios between 0 and 1, at least one")
    width = bandwidth(ratios)
    grid = np.linspace(0, 1, GRID_POINTS)
    images = np.concatenate([ratios, -ratios, 2 - ratios])
    density = np.exp(-0.5 * ((grid[:, None] - images) / width) ** 2).sum(1)
    density /= integral(density)
    # Peaks are higher than their left and not lower than their right neighbour; lower ones come from rounding.
    padded = np.concatenate([[-np.inf], density, [-np.inf]])
    peaks = (density > padded[:-2]) & (density >= padded[2:]) & (density > 1e-6 * density.max())
    return Density(
        grid=grid,
        density=density,
        bandwidth=width,
        mode=float(grid[density.argmax()]),
        modes=tuple(grid[peaks].tolist()),
        mean=integral(grid * density),
        low=_quantile(grid, density, 0.05),
        high=_quantile(grid, density, 0.95),
    )


def integral(heights: ArrayLike) -> float:
    """Integral over [0, 1] of a function given at evenly spaced points (an odd number of them), by Simpson's rule."""
    points = np.asarray(heights, np.float64)
    weights = np.full(points.size, 2.0)
    weights[1::2] = 4.0
    weights[[0, -1]] = 1.0
    return float(weights @ points / (3 * (points.size - 1)))


def _quantile(grid: _Floats, density: _Floats, level: float) -> float:
    """The point below which a fraction `level` of the mass is; the density is integrated by trapezoids."""
    pieces = (density[1:] + density[:-1]) / 2
    below = np.concatenate([[0.0], np.cumsum(pieces)])
    return float(np.interp(level, below / below[-1], grid))
