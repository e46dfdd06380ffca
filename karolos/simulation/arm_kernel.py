"""The arithmetic of an arm in compiled code: kinematics and damped least squares. `kinematics` explains it."""

from __future__ import annotations

from math import cos, sin, sqrt

import numpy as np

from ..core.compiled import compiled

POSE = 12
"""Numbers of a pose: the tool's position in m, and the unit vectors x, y, z of its frame."""
LEAP, STILL, ARRIVED = 0.5, 1e-6, 1e-4
"""Largest change of a joint in a step of `lead`; changes below which it ends, and `walk`. In rad."""


@compiled
def forward(base, links, positions, numbers):
    """Write the chain at `positions` (n,) into `numbers` (12 + 6 n,): the tool, then origin and axis of each joint.

    `links` (n + 1, 12): for each joint and the tool, translation and rotation in the frame before.
    """
    n = len(positions)
    px, py, pz = base[0], base[1], base[2]
    xx, xy, xz, yx, yy, yz, zx, zy, zz = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    for joint in range(n + 1):
        link = links[joint]
        px, py, pz = (
            px + (xx * link[0] + yx * link[1] + zx * link[2]),
            py + (xy * link[0] + yy * link[1] + zy * link[2]),
            pz + (xz * link[0] + yz * link[1] + zz * link[2]),
        )
        # columns of R * (origin's rotation); its third column is the axis
        ux, vx, wx = link[3], link[4], link[5]
        uy, vy, wy = link[6], link[7], link[8]
        uz, vz, wz = link[9], link[10], link[11]
        ax, ay, az = xx * ux + yx * uy + zx * uz, xy * ux + yy * uy + zy * uz, xz * ux + yz * uy + zz * uz
        bx, by, bz = xx * vx + yx * vy + zx * vz, xy * vx + yy * vy + zy * vz, xz * vx + yz * vy + zz * vz
        zx, zy, zz = xx * wx + yx * wy + zx * wz, xy * wx + yy * wy + zy * wz, xz * wx + yz * wy + zz * wz
        if joint == n:
            xx, xy, xz, yx, yy, yz = ax, ay, az, bx, by, bz
            continue
        k, s = cos(positions[joint]), sin(positions[joint])
        xx, xy, xz = k * ax + s * bx, k * ay + s * by, k * az + s * bz
        yx, yy, yz = k * bx - s * ax, k * by - s * ay, k * bz - s * az
        place = POSE + 6 * joint
        numbers[place], numbers[place + 1], numbers[place + 2] = px, py, pz
        numbers[place + 3], numbers[place + 4], numbers[place + 5] = zx, zy, zz
    numbers[0], numbers[1], numbers[2] = px, py, pz
    numbers[3], numbers[4], numbers[5] = xx, xy, xz
    numbers[6], numbers[7], numbers[8] = yx, yy, yz
    numbers[9], numbers[10], numbers[11] = zx, zy, zz


@compiled
def jacobian(numbers, rows):
    """Write the tool's velocity and angular velocity per rad/s of each joint into `rows` (n, 6)."""
    for joint in range(len(rows)):
        place, row = POSE + 6 * joint, rows[joint]
        rx, ry, rz = numbers[0] - numbers[place], numbers[1] - numbers[place + 1], numbers[2] - numbers[place + 2]
        ax, ay, az = numbers[place + 3], numbers[place + 4], numbers[place + 5]
        row[0], row[1], row[2] = ay * rz - az * ry, az * rx - ax * rz, ax * ry - ay * rx
        row[3], row[4], row[5] = ax, ay, az


@compiled
def velocity(numbers, rates):
    """Velocity of the tool in m/s when the joints turn at `rates` (n,) in rad/s."""
    vx = vy = vz = 0.0
    for joint in range(len(rates)):
        place, rate = POSE + 6 * joint, rates[joint]
        rx, ry, rz = numbers[0] - numbers[place], numbers[1] - numbers[place + 1], numbers[2] - numbers[place + 2]
        ax, ay, az = numbers[place + 3], numbers[place + 4], numbers[place + 5]
        vx += rate * (ay * rz - az * ry)
        vy += rate * (az * rx - ax * rz)
        vz += rate * (ax * ry - ay * rx)
    return vx, vy, vz


@compiled
def motion(base, links, positions, rates, numbers):
    """`forward`, the tool's pose as four tuples, its `velocity`, and its angular velocity in rad/s."""
    forward(base, links, positions, numbers)
    sx = sy = sz = 0.0
    for joint in range(len(rates)):
        place, rate = POSE + 6 * joint, rates[joint]
        sx += rate * numbers[place + 3]
        sy += rate * numbers[place + 4]
        sz += rate * numbers[place + 5]
    x = numbers
    tool = (x[0], x[1], x[2]), (x[3], x[4], x[5]), (x[6], x[7], x[8]), (x[9], x[10], x[11])
    return tool, velocity(numbers, rates), (sx, sy, sz)


@compiled
def step(numbers, target, posture, damping, most, change):
    """Write one step of damped least squares towards the pose `target` (12,) into `change` (n,); see `Chain.step`."""
    n = len(posture)
    rows, error, square = np.empty((n, 6)), np.empty(6), np.zeros((6, 6))
    jacobian(numbers, rows)
    for axis in range(3):
        error[axis], error[3 + axis] = target[axis] - numbers[axis], 0.0
    # half the sum of the cross products of the frame's axes with those wanted; for small errors this is the
    # rotation vector (Luh, Walker, Paul 1980)
    for axis in range(3, 12, 3):
        ax, ay, az = numbers[axis], numbers[axis + 1], numbers[axis + 2]
        bx, by, bz = target[axis], target[axis + 1], target[axis + 2]
        error[3] += 0.5 * (ay * bz - az * by)
        error[4] += 0.5 * (az * bx - ax * bz)
        error[5] += 0.5 * (ax * by - ay * bx)
    for joint in range(n):
        for i in range(6):
            error[i] -= rows[joint, i] * posture[joint]
            for k in range(i + 1):
                square[i, k] += rows[joint, i] * rows[joint, k]
    for i in range(6):  # Cholesky's factor L, then L L^T w = e
        square[i, i] += damping * damping
        for k in range(i + 1):
            total = square[i, k]
            for j in range(k):
                total -= square[i, j] * square[k, j]
            square[i, k] = sqrt(total) if i == k else total / square[k, k]
        for k in range(i):
            error[i] -= square[i, k] * error[k]
        error[i] /= square[i, i]
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            error[i] -= square[k, i] * error[k]
        error[i] /= square[i, i]
    excess = 1.0
    for joint in range(n):
        change[joint] = posture[joint]
        for i in range(6):
            change[joint] += error[i] * rows[joint, i]
        excess = max(excess, abs(change[joint]) / most[joint])
    for joint in range(n):
        change[joint] /= excess


@compiled
def lead(base, links, pose, target, rest, gain, damping, low, high, steps):
    """Change `pose` (n,) step by step until the tool is at `target` (12,); see `Chain.led`."""
    n = len(pose)
    numbers, posture, change, most = np.empty(POSE + 6 * n), np.empty(n), np.empty(n), np.full(n, np.inf)
    for _ in range(steps):
        forward(base, links, pose, numbers)
        for joint in range(n):
            posture[joint] = gain * (rest[joint] - pose[joint])
        step(numbers, target, posture, damping, most, change)
        largest = 0.0
        for joint in range(n):
            largest = max(largest, abs(change[joint]))
            moved = pose[joint] + min(max(change[joint], -LEAP), LEAP)
            pose[joint] = min(max(moved, low[joint]), high[joint])
        if largest < STILL:
            break


@compiled
def walk(base, links, pose, target, place, stride, most, gain, damping, low, high, steps):
    """Lead the tool from `pose` (n,), which it changes, to `place` (3,) by actions; see `Chain.walked`."""
    n = len(pose)
    numbers, posture, change, home = np.empty(POSE + 6 * n), np.empty(n), np.empty(n), pose.copy()
    for _ in range(steps):
        forward(base, links, pose, numbers)
        for axis in range(3):
            target[axis] = numbers[axis] + min(max(place[axis] - numbers[axis], -stride), stride)
        for joint in range(n):
            posture[joint] = gain * (home[joint] - pose[joint])
        step(numbers, target, posture, damping, most, change)
        largest = 0.0
        for joint in range(n):
            largest = max(largest, abs(change[joint]))
            pose[joint] = min(max(pose[joint] + change[joint], low[joint]), high[joint])
        if largest < ARRIVED:
            break
