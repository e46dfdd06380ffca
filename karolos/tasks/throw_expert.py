"""The scripted policy for throw."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..core import Array, FloatArray
from ..simulation.interface import Expert, RobotView
from .swing import RUN_UP

if TYPE_CHECKING:
    from .throw import Throw

RAMP = 0.28
"""Seconds in which the swing comes up to its speed: the heaviest arm has the torque for it."""
BRAKING = 3.0
"""rad/s2 with which joints come to rest at the start of the swing."""
SETTLED = 0.05, 0.3
"""rad and rad/s within which the arm has come to the start of its swing."""
PATIENCE = 40
"""Control steps after which it swings from wherever it is."""
TRACKING = 0.2
"""Share of its lag behind the swing that a joint makes up for in a control step."""
SERVO = 0.15
"""Share of a joint's lack of speed by which its next steps are lengthened. Speeds follow actions a step or two later:
larger shares of this and of `BOOST` make the swing unsteady."""
BOOST = 0.6
"""Share of what a throw would fall short of by which the swing is sped up in a control step."""
MOST_BOOST = 1.5
"""Factor by which it is sped up, or slowed down, at most."""
AHEAD = 0.25
"""Seconds ahead in which the furthest landing is looked for."""
LONGER = 0.8
"""Share of a step at full speed by which it is lengthened at most."""
OPENING = 0.01
"""Seconds from the command to open until the pads let go."""


class ThrowExpert(Expert):
    """Back to where the swing starts, then each joint to its steady speed; open where the landing comes nearest."""

    def __init__(self, robot: RobotView, task: Throw) -> None:
        self._robot = robot
        self._task = task
        self.reset()

    def reset(self) -> None:
        x, y = self._task.goal.tolist()
        throw = self._task.swing.throw_at(x, y)
        self._rates = np.array(throw.rates)
        self._start = np.array(throw.release) - self._rates * RUN_UP
        self._steps = 0
        self._swung = -1
        self._released = 0
        self._more = np.zeros_like(self._start)
        self._boost = 1.0
        self._way = 0.0  # seconds at the planned speed that make up the way so far

    def act(self) -> FloatArray:
        robot = self._robot
        joints, rates = np.array(robot.joint_positions), np.array(robot.joint_velocities)
        self._steps += 1
        left = self._start - joints
        near, slow = SETTLED
        if self._swung < 0 and (np.abs(left).max() > near or np.abs(rates).max() > slow) and self._steps < PATIENCE:
            return robot.turning(self._there(left).tolist(), 0.0)
        self._swung += 1
        if not self._released and self._swung * robot.period > RAMP and self._now(joints, rates):
            self._released = self._swung
        if self._released and self._swung > self._released:  # the hand stops, lest it hit the cube that leaves it
            return robot.turning([0.0] * len(joints), 1.0)
        # a joint that is slower than its part of the swing is told to go further, within its step
        most = LONGER * np.abs(self._rates) * robot.period
        if self._swung * robot.period > RAMP:
            faster = self._boost * (1 + BOOST * self._short(joints, rates))
            self._boost = min(max(faster, 1 / MOST_BOOST), MOST_BOOST)
        wanted = self._rates * self._boost * min(1.0, self._swung * robot.period / RAMP)
        self._more = np.clip(self._more + SERVO * (wanted - rates) * robot.period, -most, most)
        lag = left + self._rates * self._way
        # half way through the coming step the swing is that much faster than now
        pace = self._boost * min(1.0, (self._swung + 0.5) * robot.period / RAMP) * robot.period
        self._way += pace
        change = self._rates * pace + self._more + TRACKING * lag
        return robot.turning(change.tolist(), float(self._released > 0))

    def _there(self, left: Array) -> Array:
        """The changes of the joints, all in step, on a straight way of which `left` rad are left."""
        furthest = max(float(np.abs(left).max()), 1e-9)
        braking = (2 * BRAKING * furthest) ** 0.5 * self._robot.period  # v^2 = 2 a s
        share = min(
            1.0, braking / furthest, float((np.array(self._robot.joint_step) / np.maximum(np.abs(left), 1e-9)).min())
        )
        changes: Array = left * share
        return changes

    def _short(self, joints: Array, rates: Array) -> float:
        """By what share the target is further than where the cube lands if the swing goes on at these rates."""
        swing, (x, y) = self._task.swing, self._task.goal.tolist()
        times = np.linspace(0.0, AHEAD, 13)
        far = swing.landing_of(joints + np.multiply.outer(times, rates), np.broadcast_to(rates, (13, rates.size)))
        return 1 - float(far.max()) / swing.along(x, y)

    def _now(self, joints: Array, rates: Array) -> bool:
        """Whether an opening now brings the cube nearer to the target than one a control step later."""
        swing, (x, y) = self._task.swing, self._task.goal.tolist()
        times = OPENING + np.array((0.0, self._robot.period))
        far = swing.landing_of(joints + np.multiply.outer(times, rates), np.broadcast_to(rates, (2, rates.size)))
        missed = np.abs(far - swing.along(x, y))
        return bool(missed[0] <= missed[1])
