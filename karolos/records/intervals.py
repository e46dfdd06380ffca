"""The interval of a success ratio, without numpy: its import would take longer than a table of runs."""

from __future__ import annotations

import math
from statistics import NormalDist


def wilson(successes: int, episodes: int) -> tuple[float, float]:
    """95 % interval of the success probability behind k successes in n independent episodes: low, high in [0, 1].

    Wilson's score interval keeps its level at 0 and at n successes, where the normal approximation has no width.
    Source: Wilson 1927, J. Am. Stat. Assoc. 22, 209; recommended by Brown, Cai, DasGupta 2001, Stat. Sci. 16, 101.

    Raises:
        ValueError: no episodes, or successes outside 0 .. episodes.
    """
    if episodes < 1 or not 0 <= successes <= episodes:
        raise ValueError(f"{successes} successes of {episodes} episodes")
    z = NormalDist().inv_cdf(0.975)
    ratio = successes / episodes
    scale = 1 + z**2 / episodes
    middle = (ratio + z**2 / (2 * episodes)) / scale
    half = z / scale * math.sqrt(ratio * (1 - ratio) / episodes + z**2 / (4 * episodes**2))
    low: float = 0.0 if successes == 0 else max(middle - half, 0.0)  # exact where rounding would leave 1e-17
    high: float = 1.0 if successes == episodes else min(middle + half, 1.0)
    return low, high
