"""The meaning of an environment's observations and actions, by which a policy of another environment is refused."""

from __future__ import annotations

from dataclasses import dataclass
from math import isclose
from typing import Any

from ..core import Environment, Signature, layout_differences

Scale = tuple[str, tuple[float, ...]]
"""Unit, and how far an action of 1 moves each number of a field in a control step."""


@dataclass(frozen=True)
class Facts:
    """The facts of an environment that a policy relies on. Picklable."""

    signature: Signature
    rate: float
    """Control steps per second."""
    scales: dict[str, Scale]
    """By field of the robot's action; empty where the robot does not tell."""
    base: str | None
    """Where the robot stands, from which positions depend: its setting `base`; None where it has none."""

    def __deepcopy__(self, _: object) -> Facts:
        """The same, which never changes: observations are copied often."""
        return self

    @classmethod
    def of(cls, environment: Environment) -> Facts:
        """Those of an environment; nothing is simulated."""
        robot = getattr(environment, "robot", None)
        facts: dict[str, Any] = getattr(robot, "facts", dict)()
        scales = {one["name"]: (one["unit"], tuple(one["scale"])) for one in facts.get("action", ()) if "scale" in one}
        base = getattr(getattr(robot, "settings", None), "base", None)
        return cls(environment.signature, environment.rate, scales, base)

    def differences(self, trained: Facts) -> list[str]:
        """Why a policy that was trained under `trained` does not fit here, one line each."""
        lines = layout_differences(self.signature, trained.signature)
        if not isclose(self.rate, trained.rate, rel_tol=1e-6):
            lines.append(f"there are {self.rate:g} actions per second here and {trained.rate:g} there")
        if None not in (self.base, trained.base) and self.base != trained.base:
            lines.append(f"positions are those of robot.base={self.base} here and of {trained.base} there")
        for name, (unit, moved) in self.scales.items():
            known, there = trained.scales.get(name, (unit, moved))
            for one, other in zip(moved, there, strict=False):
                if unit != known or not isclose(one, other, rel_tol=1e-6):
                    lines.append(f"an action of 1 in {name} is {one:.3g} {unit} here and {other:.3g} {known} there")
                    break
        return lines
