"""Starts by stages: training episodes that begin at a later stage, e.g. with the object in the hand. Tests never do.

A task declares a probability for each stage, `start_<stage>`, and asks at a reset for the stage of the episode.
"""

from __future__ import annotations

from typing import Any

from pydantic import Field as Setting

from ..core import Settings
from ..simulation.geometry import Vector
from ..simulation.interface import RobotView


def start(how: str, **more: Any) -> Any:
    """The setting of a stage, of the type `Probability`; `more` goes to pydantic's Field."""
    return Setting(
        0.0, description=f"probability that an episode starts with {how}, if it has no earlier stage", **more
    )


def drawn_stage(drawn: Settings, draw: float, *stages: str) -> str | None:
    """The stage that an episode begins in, or None.

    Args:
        drawn: the task's settings of the episode.
        draw: uniform in [0, 1).
        stages: in order. The probability of a stage applies to the episodes without an earlier stage.
    """
    taken = 0.0
    for stage in stages:
        taken += (1 - taken) * getattr(drawn, f"start_{stage}")
        if draw < taken:
            return stage
    return None


def seen(robot: RobotView, place: Vector) -> Vector:
    """Place in m at which cameras see an object here; noise comes later. Robots of karolos 0.2 have no `seen_off`."""
    x, y, z = getattr(robot, "seen_off", (0.0, 0.0, 0.0))
    return place[0] + x, place[1] + y, place[2] + z


class ForcePenalty(Settings):
    """The cost of a step in which a force is larger than a limit. It does not depend on the goal.

    Source: FORGE (Noseworthy et al. 2024, arXiv 2408.04587), where it is .2 times the excess in N.
    """

    limit: float = Setting(50.0, gt=0, description="largest force that costs nothing, N")
    weight: float = Setting(1.0, gt=0, description="cost of twice that force; the cost grows linearly")
    most: float = Setting(1.0, gt=0, description="largest cost of a step; a sparse reward costs 1")

    def reward(self, force: float) -> float:
        """In [-most, 0], for the largest force of a step in N."""
        return -min(self.most, self.weight * max(force / self.limit - 1, 0.0))
