"""What actions mean for the joints of an arm, in compiled code: targets of the tool, and ramps of joint speeds.

A change d of a joint per control step is a speed, d / T, that the joint reaches at the end of the step:

    w = v + k (d / T - v), with d / T limited by the largest speed of the joint, w by its range
    k <= 1, the largest share with which no joint exceeds its acceleration
    r = r + (w_before + w) / 2 T, the reference, at most `REFERENCE_LAG` away from the joint before it moves
    ramp from v to w + c, c = (r - x) / T - (v + w) / 2, within the acceleration and the largest speed

x and v are the joint's position and speed, T is the period. The mean of a ramp times T is the distance that it moves
the joint. The correction c removes half of the distance between joint and reference.
All joints take the same share k of their changes of speed. With separate limits the motion would leave its direction,
and alternating actions could move the tool somewhere else.
A joint that follows its ramps moves by exactly d per step in steady motion, without loss at low speeds. A joint with
d = 0 stays at its reference under any load that its torque can hold.

If the tool would be too fast at the end of the step, by forward kinematics, all ramps' ends are scaled down by the same
factor, and the references follow.
"""

from __future__ import annotations

from math import atan2, cos, inf, sin, sqrt
from typing import NamedTuple

import numpy as np

from ..core.compiled import compiled, share
from ..simulation import geometry
from ..simulation.arm_kernel import POSE, forward, step, velocity
from ..simulation.geometry import Quaternion, Vector

share(geometry.axes, geometry.columns, geometry.from_axes, geometry.inverse, geometry.multiply, geometry.nearest)
share(geometry.rotated, geometry.rotation_about, geometry.rotation_vector, geometry.tilt_and_turn, geometry.tilted)

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
LOW, HIGH, SPEED, ACCELERATION, STEP, HOME = range(6)
"""Rows of numbers of the joints (6, n): ends of their ranges, largest speeds and accelerations, changes by an action of
1, and home positions. Units: rad and s."""


class Law(NamedTuple):
    """Numbers of an arm that say what its actions mean. Units: m, rad and s."""

    period: float
    most: float
    """Largest speed of the tool; inf: no limit."""
    damping: float
    """Of inverse kinematics, see `kinematics.Chain.step`."""
    gain: float
    """Fraction of the way back to the home pose, per control step, that inverse kinematics takes in the null space."""
    steps_down: float
    low: Vector
    high: Vector
    """Ends of the workspace."""
    tool_step: float
    turn_step: float
    own_frame: bool
    """Whether actions are in the tool's frame."""
    yaw: float
    """Of a tool that points down, where actions do not turn it."""
    yaw_step: float
    """0: actions do not turn a tool that points down."""
    middle: Quaternion
    tilt: float
    turn: float
    """Of `geometry.Orientations`."""


@compiled
def _approach(room, before, acceleration, period):
    """Largest speed in rad/s after a step from the speed `before`, towards a range's end that is `room` rad away."""
    speed, mean = room / BRAKING_TIME, acceleration * period / 4
    left = acceleration * (room - before * period / 2)  # w^2 = acceleration (room - (before + w) / 2 period)
    return min(speed, sqrt(mean * mean + left) - mean if left > 0 else 0.0) if room > 0 else speed


@compiled
def ramp(period, most, joints, base, links, state, positions, velocities, numbers, changes, ramps):
    """Write begin and end of the ramps of all joints in rad/s into `ramps` (2, n).

    They begin at `velocities`, limited to the largest speeds: a joint that a contact drives faster is braked at once.

    Args:
        period: of a control step in s.
        most: largest speed of the tool in m/s; inf: no limit.
        joints: see `LOW`.
        base, links: of the chain, as in `forward`.
        state: references in rad and speeds in rad/s (2, n); written.
        positions, velocities, changes: the present ones and the wanted changes of the joints, (n,) each.
        numbers: of the chain at the positions.
    """
    n, begins, ends = len(positions), ramps[0], ramps[1]
    share = 1.0
    for j in range(n):
        begins[j] = min(max(velocities[j], -joints[SPEED, j]), joints[SPEED, j])
        limit = SPEED_SHARE * joints[SPEED, j]
        ends[j] = min(max(changes[j] / period, -limit), limit)
        far = abs(ends[j] - begins[j])
        if far * share > joints[ACCELERATION, j] * period:
            share = joints[ACCELERATION, j] * period / far
    for j in range(n):
        at, v, rise = positions[j], begins[j], joints[ACCELERATION, j] * period
        low, high, limit, acceleration = joints[LOW, j], joints[HIGH, j], joints[SPEED, j], joints[ACCELERATION, j]
        braking = max(BRAKING_TIME, limit / acceleration + period)
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
            rise = joints[ACCELERATION, j] * period
            slowed[j] = min(max(share * ends[j], begins[j] - rise), begins[j] + rise)
    if share < 1:  # nothing is caught up later
        for j in range(n):
            state[0, j] = positions[j] + period / 2 * (begins[j] + slowed[j])
            state[1, j] = ends[j] = slowed[j]


@compiled
def turn_joints(law, joints, base, links, state, positions, velocities, numbers, values, ramps):
    """`ramp` for the actions of joint control: `values`, each in [-1, 1], one per joint or more."""
    changes = np.empty(len(positions))
    for j in range(len(positions)):
        changes[j] = joints[STEP, j] * values[j]
    ramp(law.period, law.most, joints, base, links, state, positions, velocities, numbers, changes, ramps)


@compiled
def _lowest(law, numbers, velocities):
    """Lowest height to aim at, so that the tool comes to rest at the lower end of the workspace and not below.

    A control step moves the tool by the mean of its speeds before and after. Afterwards the step s may be as long as
    the distance that is then left: s = d - (v T + s) / 2. This would be a factor of 1.5 for `steps_down`. With 2,
    joints that also turn for a motion sideways keep enough of their accelerations to brake.
    """
    low, z, speed = law.low[2], numbers[2], min(velocity(numbers, velocities)[2], 0.0)
    return max(low, z - (z - low + speed * law.period / 2) / law.steps_down)


@compiled
def _ahead(law, start, change, low_z):
    """The position that is `change` m away from `start`, inside the workspace and not lower than `low_z`."""
    return (
        min(max(start[0] + change[0], law.low[0]), law.high[0]),
        min(max(start[1] + change[1], law.low[1]), law.high[1]),
        min(max(start[2] + change[2], low_z), law.high[2]),
    )


@compiled
def _sinks(law, base, links, positions, velocities, numbers, changes):
    """How far in m the tool comes to rest below a straight way, because joints that turn lead it on a curve.

    It is twice the distance at the end of the step: the tool then moves down, and the next step takes as long to brake
    it.
    """
    half, speeds, there = law.period / 2, changes / law.period, np.empty_like(numbers)
    forward(base, links, positions + half * (velocities + speeds), there)
    fall = velocity(numbers, velocities)[2] + velocity(numbers, speeds)[2]
    return 2 * (numbers[2] + half * fall - there[2])


@compiled
def _aim(law, joints, base, links, state, positions, velocities, numbers, target, lowest, ramps):
    """`ramp` towards a pose of the tool (12,), scaled down so that no joint exceeds its step.

    Near the lower end of the workspace the target is raised by what the way there curves down.
    """
    n = len(positions)
    posture, changes = np.empty(n), np.empty(n)
    for j in range(n):
        posture[j] = law.gain * (joints[HOME, j] - positions[j])
    step(numbers, target, posture, law.damping, joints[STEP], changes)
    # with steps of 3.4 cm at most 7 mm were measured (a UR5, full actions), so half a step is near enough to look
    if target[2] < lowest + law.tool_step / 2:
        raised = lowest + _sinks(law, base, links, positions, velocities, numbers, changes)
        if target[2] < raised:
            target[2] = raised
            step(numbers, target, posture, law.damping, joints[STEP], changes)
    ramp(law.period, law.most, joints, base, links, state, positions, velocities, numbers, changes, ramps)


@compiled
def move_tool(law, joints, base, links, state, positions, velocities, numbers, values, ramps):
    """`ramp` for the actions of cartesian control: a tool that points down is moved, and turned where they can."""
    target, lowest, size = np.zeros(POSE), _lowest(law, numbers, velocities), law.tool_step
    change = size * values[0], size * values[1], size * values[2]
    target[0], target[1], target[2] = _ahead(law, numbers, change, lowest)
    yaw = atan2(numbers[4], numbers[3]) + law.yaw_step * values[3] if law.yaw_step > 0 else law.yaw
    target[3], target[4], target[6], target[7], target[11] = cos(yaw), sin(yaw), sin(yaw), -cos(yaw), -1.0
    _aim(law, joints, base, links, state, positions, velocities, numbers, target, lowest, ramps)


@compiled
def changed(law, position, orientation, own, values, low_z):
    """The position and orientation that an action of pose control makes of these; `own`: the tool's orientation."""
    size, angle = law.tool_step, law.turn_step
    shift, turn = (
        (size * values[0], size * values[1], size * values[2]),
        (angle * values[3], angle * values[4], angle * values[5]),
    )
    if law.own_frame:
        shift, turn = geometry.rotated(own, shift), geometry.rotated(own, turn)
    turned = geometry.multiply(geometry.rotation_about(turn), orientation)
    return _ahead(law, position, shift, low_z), geometry.nearest(law.middle, law.tilt, law.turn, turned)


@compiled
def move_pose(law, joints, base, links, state, positions, velocities, numbers, values, ramps):
    """`ramp` for the actions of pose control: the tool is moved and turned."""
    target, lowest, x = np.empty(POSE), _lowest(law, numbers, velocities), numbers
    own = geometry.from_axes((x[3], x[4], x[5]), (x[6], x[7], x[8]), (x[9], x[10], x[11]))
    position, orientation = changed(law, (x[0], x[1], x[2]), own, own, values, lowest)
    place = 0
    for one in (position, *geometry.axes(orientation)):
        for axis in range(3):
            target[place + axis] = one[axis]
        place += 3
    _aim(law, joints, base, links, state, positions, velocities, numbers, target, lowest, ramps)
