"""How far an arm can throw, and the swing that throws so far: kinematics alone, no physics.

A swing turns the joints whose axes lie level and side by side, so that the tool moves in one upright plane, each at a
steady speed within its limit; the joint below them turns that plane towards the target. The object leaves where its
landing lies furthest along the swing: there an opening that comes a little early or late matters least. Slower swings
throw less far. Landings follow from free fall (no air drag).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from math import atan2, cos, hypot, pi, sin
from typing import NamedTuple

import numpy as np

from ..core import Array
from ..errors import UsageError
from ..simulation.interface import RobotView
from ..simulation.world import GRAVITY

RUN_UP = 0.35
"""Seconds at steady speed before the release, in which the arm comes up to its speed."""
FOLLOW = 0.15
"""Seconds at steady speed after it, in which the gripper opens."""
CLEAR = 0.12
"""m above the floor that the tool and the joints that swing keep."""
KEPT_OUT = 0.2
"""m from the axis of the joint that turns the plane that the tool keeps while it is lower than .2 m above the first
joint that swings: there the arm's base stands."""
UNFOLDED = 0.4
"""Share of its largest distance from the first joint that swings which the tool keeps, so that the hand does not meet
the upper arm."""
POINTS = 9
"""Of the grid along each joint; the grid then closes in on the best point."""
ROUNDS = 5
SLOWEST = 0.3
"""Share of the full speed of the slowest swing."""


class Throw(NamedTuple):
    """A swing for one target; all joints of the arm, in rad and rad/s."""

    release: tuple[float, ...]
    """Joint positions at which the object leaves."""
    rates: tuple[float, ...]
    """Joint velocities all through the swing."""


def landing(position: Array, velocity: Array, height: float) -> Array:
    """How far along the level what flies from `position` comes down to `height`, in m.

    Complex numbers: the level part is real, the height imaginary; m and m/s.
    """
    rise = velocity.imag
    drop = np.maximum(position.imag - height, 0.0)
    seconds = (rise + np.sqrt(rise * rise - 2 * GRAVITY * drop)) / -GRAVITY
    far: Array = position.real + velocity.real * seconds
    return far


class Swing:
    """The furthest swing of a robot, and from it the throw at any target nearer by.

    Args:
        height: of the object's centre above the floor when it has landed, in m.

    Attributes:
        reach: the furthest that the tool can be from the robot's axis along the level, in m.
        furthest: the furthest landing of a throw from that axis, in m.

    Raises:
        UsageError: no joint turns an upright plane with two joints that swing in it, or actions turn no joints.
    """

    def __init__(self, robot: RobotView, height: float) -> None:
        if not robot.turns_joints:
            raise UsageError(
                "cartesian control keeps the gripper pointing down and within the workspace, and no throw from there "
                "gets out of the arm's reach",
                where="robot.control",
                hint="set robot.control: joint, which throws with the speed of every joint",
            )
        self._robot = robot
        self._height = height
        self._find_joints()
        limits = robot.limits
        self._home = np.array(robot.home_joints)
        speed = np.minimum(limits.velocity, np.array(robot.joint_step) / robot.period)
        # a joint that turns on and on is used from -pi to pi
        low = np.maximum(limits.lower, self._home - pi)
        high = np.minimum(limits.upper, self._home + pi)
        self._low, self._high, self._speed = low[self._swinging], high[self._swinging], speed[self._swinging]
        planar, self._span = self._search_reach()
        self.reach = hypot(planar, self._aside)
        self._angles, self._rates = self._search_throw()
        # how far swings of less than full speed throw, and when along them the object leaves
        self._shares = np.linspace(SLOWEST, 1.0, 71)
        self._times = np.linspace(-RUN_UP / 2, FOLLOW, 46)
        far = np.stack([self._distances(share, self._times) for share in self._shares])
        self._leaving = self._times[far.argmax(1)]
        self._far = np.maximum.accumulate(far.max(1))
        self.furthest = hypot(float(self._far[-1]), self._aside)

    def _find_joints(self) -> None:
        """Which joints turn the plane and swing in it, from their axes at the home pose."""
        robot = self._robot
        at = robot.forward(robot.home_joints)
        places = np.array(at.places).reshape(-1, 6)
        points, axes = places[:, :3], places[:, 3:]
        upright = np.flatnonzero(np.abs(axes[:, 2]) > 0.999)
        level = np.flatnonzero(np.abs(axes[:, 2]) < 0.001)
        if upright.size and level.size:
            normal = axes[level[0]]
            ahead = np.cross((0.0, 0.0, 1.0), normal)  # turning about the normal lifts what is ahead
            self._turning = int(upright[0])
            self._centre = points[self._turning, :2]
            tool = np.array(at.tool.position)
            if (tool[:2] - self._centre) @ ahead[:2] < 0:
                normal, ahead = -normal, -ahead
            self._swinging = level[np.abs(axes[level] @ normal) > 0.999]
        if not (upright.size and level.size and upright[0] < level[0] and self._swinging.size >= 2):
            raise UsageError(
                "this arm cannot be told how to throw: no joint turns about the vertical with two level, parallel ones "
                "beyond it",
                where="robot",
                hint="at the home pose; choose another robot, or another task",
            )
        self._turn_sign = float(np.sign(axes[self._turning, 2]))
        self._signs = axes[self._swinging] @ normal
        corners = np.vstack([points[self._swinging], tool])
        flat = (corners[:, :2] - self._centre) @ ahead[:2] + 1j * corners[:, 2]
        self._first, self._parts = flat[0], np.diff(flat)
        self._aside = float((tool[:2] - self._centre) @ normal[:2])
        self._azimuth = atan2(ahead[1], ahead[0])
        # the pads face along the tool's y: a wrist turns them to face across the plane, out of the object's way
        self._wrist = int(upright[-1]) if upright[-1] > self._swinging[-1] else None
        y = at.tool.y
        error = atan2(normal[0] * y[1] - normal[1] * y[0], normal[0] * y[0] + normal[1] * y[1])
        error = (error + pi / 2) % pi - pi / 2  # either pad may be on either side
        self._wrist_turn = -error * float(np.sign(axes[self._wrist, 2])) if self._wrist is not None else 0.0

    def _corners(self, angles: Array) -> Array:
        """(..., k + 1) complex: the joints that swing and the tool in their plane, at joint positions (..., k)."""
        turned = np.cumsum((angles - self._home[self._swinging]) * self._signs, -1)
        arms = self._parts * np.exp(1j * turned)
        first = np.broadcast_to(self._first, (*arms.shape[:-1], 1))
        return np.concatenate([first, self._first + np.cumsum(arms, -1)], -1)

    def _velocity(self, corners: Array, rates: Array) -> Array:
        """(...) complex: of the tool in m/s."""
        tool = corners[..., -1:]
        velocity: Array = (1j * (tool - corners[..., :-1]) * rates * self._signs).sum(-1)
        return velocity

    def _search(self, worth: Callable[[Array], Array], low: Array, high: Array) -> tuple[Array, float]:
        """The joint positions (k,) of most worth on a grid between `low` and `high` that closes in, and the worth."""
        best, most = (low + high) / 2, -np.inf
        begin, end = low, high
        for _ in range(ROUNDS):
            axes = [np.linspace(a, b, POINTS) for a, b in zip(begin, end, strict=True)]
            grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, low.size)
            worths = worth(grid)
            place = int(worths.argmax())
            if worths[place] > most:
                best, most = grid[place], float(worths[place])
            step = (end - begin) / (POINTS - 1)
            begin, end = np.maximum(best - 1.5 * step, low), np.minimum(best + 1.5 * step, high)
        return best, most

    def _search_reach(self) -> tuple[float, float]:
        """The largest distance of the tool along the level from the axis, and in space from the first joint."""
        level = self._search(lambda angles: self._corners(angles)[:, -1].real, self._low, self._high)[1]
        space = self._search(lambda angles: abs(self._corners(angles)[:, -1] - self._first), self._low, self._high)[1]
        return level, space

    def _search_throw(self) -> tuple[Array, Array]:
        """Joint positions at the release and joint velocities of the furthest throw."""
        best: tuple[float, Array, Array] | None = None
        for signs in product((-1.0, 1.0), repeat=self._swinging.size):
            rates = self._speed * signs
            before, after = rates * RUN_UP, rates * FOLLOW
            low = np.maximum(self._low, np.maximum(self._low + before, self._low - after))
            high = np.minimum(self._high, np.minimum(self._high + before, self._high - after))
            if (low > high).any():
                continue

            def worth(angles: Array, rates: Array = rates) -> Array:
                corners = self._corners(angles)
                far = landing(corners[:, -1], self._velocity(corners, rates), self._height)
                return np.where(self._free(angles, rates), far, -np.inf)

            angles, far = self._search(worth, low, high)
            if np.isfinite(far) and (best is None or far > best[0]):
                best = far, angles, rates
        if best is None:
            raise UsageError("this arm has no room to swing", where="robot", hint="choose another robot")
        return best[1], best[2]

    def _free(self, angles: Array, rates: Array) -> Array:
        """Whether a swing keeps off the floor and the arm itself, on the way to its start too."""
        start, home = angles - rates * RUN_UP, self._home[self._swinging]
        free = np.ones(len(angles), np.bool_)
        for stop in (start, (2 * start + home) / 3, angles - rates * RUN_UP / 2, angles, angles + rates * FOLLOW):
            corners = self._corners(stop)
            tool = corners[:, -1]
            free &= (corners[:, 1:].imag > CLEAR).all(1)
            free &= (tool.real > KEPT_OUT) | (tool.imag > self._first.imag + KEPT_OUT)
            free &= abs(tool - self._first) > UNFOLDED * self._span
        return free

    def _distances(self, share: float, times: Array) -> Array:
        """Where what leaves at these times along the swing lands."""
        rates = self._rates * share
        corners = self._corners(self._angles + np.multiply.outer(times, rates))
        return landing(corners[:, -1], self._velocity(corners, rates), self._height)

    def throw_at(self, x: float, y: float) -> Throw:
        """The throw that lands at x, y m; as near it as can be for a target out of range."""
        away, far = (x - self._centre[0], y - self._centre[1]), self.along(x, y)
        share = float(np.interp(far, self._far, self._shares))
        leaving = float(np.interp(share, self._shares, self._leaving))
        joints, rates = self._home.copy(), np.zeros_like(self._home)
        rates[self._swinging] = self._rates * share
        joints[self._swinging] = self._angles + leaving * self._rates * share
        turn = atan2(away[1], away[0]) - self._azimuth + atan2(self._aside, far)
        joints[self._turning] += atan2(sin(turn), cos(turn)) * self._turn_sign
        if self._wrist is not None:
            joints[self._wrist] += self._wrist_turn
        return Throw(tuple(joints.tolist()), tuple(rates.tolist()))

    def along(self, x: float, y: float) -> float:
        """How far x, y m lies from the axis in the plane of a swing that is turned to pass over it, in m."""
        away = hypot(x - self._centre[0], y - self._centre[1])
        return float(max(away * away - self._aside**2, 0.0) ** 0.5)

    def landing_of(self, joints: Array, rates: Array) -> Array:
        """Where what leaves the tool now would land: distance from the axis in m along the plane of the swing.

        Args:
            joints: positions (..., n) of all joints.
            rates: velocities (..., n).
        """
        corners = self._corners(joints[..., self._swinging])
        return landing(corners[..., -1], self._velocity(corners, rates[..., self._swinging]), self._height)
