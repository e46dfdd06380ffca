"""The protective stop of a cobot: limits of force and torque beyond which it stops.

Universal Robots limit the force of the tool, by default to 150 N (safety configuration), and need up to .25 s to notice
a violation (manual of UR5/CB3, "General limits", "Limiting safety-related functions"). ISO/TS 15066 allows
140 N for a lasting contact with hand and fingers, and twice that for a transient one. Franka Emika leave the thresholds
of forces and joint torques to the user (libfranka, `setCollisionBehavior`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pydantic import Field as Setting

from ..core import Settings

TORQUE_TOLERANCE = 0.999
"""Fraction of a torque above which a motor counts as using all of it."""


class ProtectiveStop(Settings):
    """Limits beyond which an arm stops."""

    force: float | None = Setting(
        150.0, gt=0, description="largest force of a body or another link on a link in a physics step, N; null: off"
    )
    torque: float | None = Setting(
        1.0, gt=0, le=1, description="largest torque of a motor for `seconds`, as a fraction of its limit; null: off"
    )
    seconds: float = Setting(0.25, gt=0, le=10, description="time with more than that torque after which the arm stops")
    ends: bool = Setting(True, description="whether a stop ends the episode without success; false: it is only counted")


class Guard:
    """Watches an arm after each control step.

    Args:
        limits: of force and torque.
        effort: largest torque of each joint in N m.
        period: duration of a control step in s.

    Attributes:
        available: fraction of each largest torque that friction leaves to the motor.
        stops: number of times that a limit was exceeded since the reset; a lasting excess counts once.
        stopped: whether a stop has ended the episode.
    """

    def __init__(self, limits: ProtectiveStop, effort: Sequence[float], period: float) -> None:
        self._force = limits.force
        self._torques = [TORQUE_TOLERANCE * limits.torque * most for most in effort] if limits.torque else []
        self._patience = limits.seconds / period
        self._ends = limits.ends
        self.available = 1.0
        self.reset()

    def reset(self) -> None:
        """Start a new episode."""
        self.stops, self.stopped = 0, False
        self._exceeded = False
        self._steps = [0] * len(self._torques)
        """Number of consecutive control steps in which each motor used the torque."""

    def watch(self, forces: Mapping[tuple[int, int], float], torques: Sequence[float]) -> None:
        """Compare with the limits: forces in N as `World.forces` gives them, torques (n,) of the motors in N m."""
        exceeded = self._force is not None and max(forces.values(), default=0.0) > self._force
        if self._torques:
            self._steps = [
                steps + 1 if abs(torque) >= self.available * most else 0
                for steps, torque, most in zip(self._steps, torques, self._torques, strict=True)
            ]
            exceeded = exceeded or max(self._steps) >= self._patience
        if exceeded and not self._exceeded:
            self.stops += 1
            self.stopped = self._ends
        self._exceeded = exceeded
