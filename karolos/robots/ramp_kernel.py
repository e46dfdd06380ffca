"""Ramps of joint speeds in compiled code. `ramps` explains them."""

from __future__ import annotations

from math import inf, sqrt

import numpy as np

from ..core.compiled import compiled
from ..simulation.arm_kernel import forward, velocity

BRAKING_TIME = 1 / 12
"""Time constant, in s, with which a joint approaches the end of its range. A hard stop would push the other joints.
Further away, its speed at the end of a step is limited so that half of its acceleration can stop it."""
REFERENCE_LAG = 0.01
"""Largest distance, in rad, of the reference from its joint. It limits the error that a blocked arm accumulates."""
SPEED_SHARE = 0.97
"""Fraction of a joint's largest speed in steady motion. The rest is for the correction of its reference."""
SLOW_TOOL = 0.8
"""Fraction of that speed below which the tool's speed at the present pose needs no exact check."""
SCALINGS = 4
"""Largest number of times that a ramp is scaled down. Once is not enough if accelerations limit the braking."""


@compiled
def _approach(room, before, acceleration, period):
    """Largest speed in rad/s after a step from the speed `before`, towards a range's end that is `room` rad away."""
    speed, mean = room / BRAKING_TIME, acceleration * period / 4
    left = acceleration * (room - before * period / 2)  # w^2 = acceleration (room - (before + w) / 2 period)
    return min(speed, sqrt(mean * mean + left) - mean if left > 0 else 0.0) if room > 0 else speed


@compiled
def ramp(period, bounds, state, positions, velocities, changes, ramps, most, base, links, numbers):
    """Write begin and end of the ramps of all joints in rad/s into `ramps` (2, n); see `ramps.Ramps`.

    Args:
        period: of a control step in s.
        bounds: (n, 5): lowest and highest position, largest speed and acceleration, time in which it brakes.
        state: references in rad and speeds in rad/s (2, n); written.
        positions, velocities, changes: the present ones and the wanted changes of the joints, (n,) each.
        most: largest speed of the tool in m/s; inf: no limit.
        base, links: of the chain, as in `forward`.
        numbers: of the chain at the positions.
    """
    n, begins, ends = len(positions), ramps[0], ramps[1]
    share = 1.0
    for j in range(n):
        begins[j] = min(max(velocities[j], -bounds[j, 2]), bounds[j, 2])
        limit = SPEED_SHARE * bounds[j, 2]
        ends[j] = min(max(changes[j] / period, -limit), limit)
        far = abs(ends[j] - begins[j])
        if far * share > bounds[j, 3] * period:
            share = bounds[j, 3] * period / far
    for j in range(n):
        at, v, rise = positions[j], begins[j], bounds[j, 3] * period
        low, high, limit = bounds[j, 0], bounds[j, 1], bounds[j, 2]
        acceleration, braking = bounds[j, 3], bounds[j, 4]
        speed = v + share * (ends[j] - v)
        if at + braking * speed > high:
            speed = max(min(speed, _approach(high - at, v, acceleration, period)), v - rise)
        elif at + braking * speed < low:
            speed = min(max(speed, -_approach(at - low, -v, acceleration, period)), v + rise)
        held = min(max(state[0, j], at - REFERENCE_LAG), at + REFERENCE_LAG)
        reference = held + (state[1, j] + speed) / 2 * period
        end = speed + (reference - at) / period - (v + speed) / 2
        state[0, j], state[1, j] = reference, speed
        ends[j] = min(max(end, v - rise, -limit), v + rise, limit)
    if most == inf:
        return
    x, y, z = velocity(numbers, ends)
    if sqrt(x * x + y * y + z * z) <= SLOW_TOOL * most:
        return
    after, there, share, slowed = np.empty(n), np.empty_like(numbers), 1.0, ends.copy()
    for _ in range(SCALINGS):  # until the tool moves at `most` after the step, or all joints brake
        for j in range(n):
            after[j] = positions[j] + period / 2 * (begins[j] + slowed[j])
        forward(base, links, after, there)
        x, y, z = velocity(there, slowed)
        speed = sqrt(x * x + y * y + z * z)
        if speed <= most:
            break
        share *= most / speed
        for j in range(n):
            rise = bounds[j, 3] * period
            slowed[j] = min(max(share * ends[j], begins[j] - rise), begins[j] + rise)
    if share < 1:  # nothing is caught up later
        for j in range(n):
            state[0, j] = positions[j] + period / 2 * (begins[j] + slowed[j])
            state[1, j] = ends[j] = slowed[j]
