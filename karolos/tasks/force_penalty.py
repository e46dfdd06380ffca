"""A reward that falls when the arm presses too hard."""

from __future__ import annotations

from pydantic import Field as Setting

from ..core import Settings


class ForcePenalty(Settings):
    """What a step costs in which a force is larger than a limit, whatever the goal.

    Source: FORGE (Noseworthy et al. 2024, arXiv 2408.04587), where it is .2 times the excess in N.
    """

    limit: float = Setting(50.0, gt=0, description="largest force without a cost, N")
    weight: float = Setting(1.0, gt=0, description="cost of a force of twice the limit; it grows linearly")
    most: float = Setting(1.0, gt=0, description="largest cost of a step; a sparse reward of -1 is what time costs")

    def reward(self, force: float) -> float:
        """In [-most, 0], for the largest force of a step in N."""
        return -min(self.most, self.weight * max(force / self.limit - 1, 0.0))
