"""Turns changes of joint positions into ramps of joint speeds, within the limits of the joints and of the tool."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from math import inf

import numpy as np

from ..core import Array
from ..simulation.interface import JointLimits
from ..simulation.kinematics import Chain, Configuration, Numbers

ACCELERATION_TIME = 1 / 24
"""Seconds in which a joint changes its speed by its largest speed, if no acceleration of the data sheet is used."""
TOOL_SPEED_SHARE = 0.98
"""Fraction of the tool's largest speed at the end of a control step. The rest is for the motion inside the step."""
NONE = np.zeros(0)
"""Placeholder for an arm without a tool."""


class Ramps:
    """Turns changes of joint positions into ramps of joint speeds, one per control step.

    A change d per control step is a speed, d / T, that the joint reaches at the end of the step:

        w = v + k (d / T - v), with d / T limited by the largest speed of the joint, w by its range
        k <= 1, the largest share with which no joint exceeds its acceleration
        r = r + (w_before + w) / 2 T, the reference, at most `REFERENCE_LAG` away from the joint before it moves
        ramp from v to w + c, c = (r - x) / T - (v + w) / 2, within the acceleration and the largest speed

    x and v are the joint's position and speed, T is the period. The mean of a ramp times T is the distance that it
    moves the joint. The correction c removes half of the distance between joint and reference.
    All joints take the same share k of their changes of speed. With separate limits the motion would leave its
    direction, and alternating actions could move the tool somewhere else.
    A joint that follows its ramps moves by exactly d per step in steady motion, without loss at low speeds. A joint
    with d = 0 stays at its reference under any load that its torque can hold.

    If the tool would be too fast at the end of the step, by forward kinematics, all ramps' ends are scaled down by the
    same factor, and the references follow.

    Args:
        limits: of the joints.
        period: duration T of a control step in s.
        accelerations: largest acceleration of each joint in rad/s2.
        tool: kinematics of the arm, and the largest speed of its tool in m/s.
    """

    def __init__(
        self,
        limits: JointLimits,
        period: float,
        accelerations: Sequence[float],
        tool: tuple[Chain, float] | None = None,
    ) -> None:
        self._kernel = import_module(".ramp_kernel", __package__)  # heavy, so it is imported when an arm is built
        self._period = period
        self._tool = tool
        self._state = np.zeros((2, len(accelerations)))
        """References in rad and speeds in rad/s."""
        self._bounds = np.array(
            [
                (low, high, speed, acceleration, max(self._kernel.BRAKING_TIME, speed / acceleration + period))
                for low, high, speed, acceleration in zip(
                    limits.lower, limits.upper, limits.velocity, accelerations, strict=True
                )
            ]
        )

    def reset(self, positions: Numbers) -> None:
        """Start from these positions in rad, at rest."""
        self._state[:] = positions, [0.0] * len(positions)

    def ramp(self, positions: Array, velocities: Array, changes: Array, pose: Configuration | None = None) -> Array:
        """Speeds (2, n) in rad/s at begin and end of ramps that change joints at `positions` (n,) by `changes` (n,).

        They begin at `velocities` (n,), limited to the largest speeds: a joint that a contact drives faster is braked
        at once. `pose` is the chain at `positions`; without it the speed of the tool is not limited.
        """
        ramps = np.empty((2, len(self._bounds)))
        if not positions.shape == velocities.shape == changes.shape == ramps.shape[1:]:
            raise ValueError(f"{positions.shape} {velocities.shape} {changes.shape}: (n,) with n = {len(self._bounds)}")
        most, chain = inf, (NONE, NONE[None], NONE)
        if self._tool is not None and pose is not None:
            most = TOOL_SPEED_SHARE * self._tool[1]
            chain = self._tool[0].base, self._tool[0].links, pose.numbers
        self._kernel.ramp(self._period, self._bounds, self._state, positions, velocities, changes, ramps, most, *chain)
        return ramps
