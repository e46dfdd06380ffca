"""Turns a policy's actions into set points at the robot's rate, like karolos' control modes, within the robot's limits.

In training a control step is a linear ramp of joint speeds. Here the ramp is a path of set points. The commands to the
robot follow it within its limits of speed, acceleration and jerk.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .kinematics import Array, Chain, Configuration, Orientations, turn_of, turned_by
from .readings import SetPoint

SPEED_SHARE, TOOL_SPEED_SHARE = 0.97, 0.98
"""Fractions of the largest speeds of joints and tool in steady motion, as in training."""
BRAKING_TIME = 1 / 12
"""Time constant, in s, with which a joint approaches the end of its range."""
LAG, LAG_TIME = 0.015, 0.04
"""Largest distance of the start of a path from the read joint: this angle in rad, plus its way in this time in s."""
JERK_TIME = 0.004
"""Time in s in which a joint reaches its largest acceleration."""
CATCH_UP = 0.05
"""Time constant, in s, with which set points return to the path after limits."""


class Motion:
    """Turns actions into set points.

    Args:
        share: used fraction of the joints' accelerations.
    """

    def __init__(self, contract: Mapping[str, Any], chain: Chain, share: float = 1.0) -> None:
        self.control, self.chain = contract["control"], chain
        self.mode: str = self.control["mode"]
        self.period = 1 / self.control["rate"]
        joints = contract["joints"]
        self.lower, self.upper, self.speed, self.acceleration, self.home = (
            np.array([joint[key] for joint in joints]) for key in ("lower", "upper", "velocity", "acceleration", "home")
        )
        self.acceleration = share * self.acceleration
        self.low, self.high = np.array(contract["workspace"])
        self.tool_speed = contract["limits"].get("tool_speed") or np.inf
        turns = self.control["orientations"]
        self._turns = Orientations(turns["middle"], turns["tilt"], turns["turn"])
        self._gripper = contract["action"][-1]["name"] == "gripper_opening"
        self._spring = self.control.get("spring")

    def reset(self, positions: Array, at: Configuration) -> None:
        """Begin an episode at rest, with the joints at their read positions."""
        self.positions, self.velocities = positions.copy(), np.zeros_like(positions)
        """The last command to the robot."""
        self._accelerations = np.zeros_like(positions)
        self._place, self._rotation = at.position, at.rotation
        """Position and rotation of the spring's set point."""
        self._begin = 0.0
        self._from = self._to = self.velocities
        self._anchor = self.positions
        self._spring_from = self._place, self._rotation
        self._opening = 1.0 if self._gripper else None

    def set_point_from(self, at: Configuration) -> Array:
        """The observation of a spring's set point: the way from the tool to it (6,), m and rad."""
        if self._spring is None:
            return np.zeros(6)
        shift, turn = self._place - at.position, turn_of(self._rotation @ at.rotation.T)
        return np.concatenate(
            [shortened(shift, self._spring["error_limit"]), shortened(turn, self._spring["turn_error_limit"])]
        )

    def plan(self, action: Array, positions: Array, at: Configuration, now: float) -> None:
        """Accept an action (a,), in [-1, 1], at the beginning of a control step.

        Args:
            positions: of the joints as they were read (n,).
            at: the chain there.
            now: of the executor's clock in s.
        """
        values = np.clip(np.asarray(action, float), -1, 1)
        self._begin = now
        if self._gripper:
            self._opening = float(0.5 + 0.5 * values[-1])
        if self.mode == "impedance":
            self._plan_spring(values, at)
            return
        room = LAG + LAG_TIME * np.abs(self.velocities)
        self._anchor = np.clip(self.positions, positions - room, positions + room)
        self._from = self.velocities.copy()
        there = self.chain.at(self._anchor)  # a reading is late, the last command is not
        self._to = self._ramp(self._anchor, self._changes(values, self._anchor, there))

    def at(self, now: float, cycle: float) -> SetPoint:
        """The set point for the end of a cycle of `cycle` s that begins at `now`."""
        share = min((now + cycle - self._begin) / self.period, 1.0)
        if self.mode == "impedance":
            (place, rotation), turn = self._spring_from, turn_of(self._rotation @ self._spring_from[1].T)
            moving = float(share < 1) / self.period
            velocity = np.concatenate([(self._place - place) * moving, turn * moving])
            there = place + share * (self._place - place)
            return SetPoint(
                place=there, rotation=turned_by(share * turn) @ rotation, velocity=velocity, opening=self._opening
            )
        seconds = share * self.period
        speed = self._from + share * (self._to - self._from)
        path = self._anchor + seconds * (self._from + speed) / 2 + (now + cycle - self._begin - seconds) * speed
        self._follow(path, speed, cycle)
        return SetPoint(self.positions, self.velocities, opening=self._opening)

    def _follow(self, path: Array, speed: Array, cycle: float) -> None:
        """Move the command towards a path, within speed, acceleration and jerk."""
        wanted = np.clip(speed + (path - cycle * speed - self.positions) / CATCH_UP, -self.speed, self.speed)
        jerk = self.acceleration / JERK_TIME * cycle
        change = np.clip((wanted - self.velocities) / cycle, self._accelerations - jerk, self._accelerations + jerk)
        self._accelerations = np.clip(change, -self.acceleration, self.acceleration)
        before = self.velocities
        self.velocities = np.clip(before + cycle * self._accelerations, -self.speed, self.speed)
        self.positions = np.clip(self.positions + cycle * (before + self.velocities) / 2, self.lower, self.upper)

    def _ramp(self, positions: Array, changes: Array) -> Array:
        """Joint speeds (n,) at the end of a control step that changes the joints by `changes`: `ramp` of karolos."""
        before, rise = self.velocities, self.acceleration * self.period
        wanted = np.clip(changes / self.period, -SPEED_SHARE * self.speed, SPEED_SHARE * self.speed)
        share = min(1.0, float((rise / np.maximum(np.abs(wanted - before), 1e-12)).min()))
        speed = before + share * (wanted - before)
        braking, mean = np.maximum(BRAKING_TIME, self.speed / self.acceleration + self.period), rise / 4
        for end, sign in ((self.upper, 1.0), (self.lower, -1.0)):
            room = sign * (end - positions)
            left = np.maximum(self.acceleration * (room - sign * before * self.period / 2), 0.0)
            slow = np.where(
                room > 0, np.minimum(room / BRAKING_TIME, np.sqrt(mean**2 + left) - mean), room / BRAKING_TIME
            )
            speed = np.where(
                braking * sign * speed > room,
                sign * np.maximum(np.minimum(sign * speed, slow), sign * before - rise),
                speed,
            )
        most, full = TOOL_SPEED_SHARE * self.tool_speed, speed
        for _ in range(4):
            after = self.chain.at(positions + self.period / 2 * (before + speed))
            moving = float(np.linalg.norm(after.jacobian[:3] @ speed))
            if moving <= most:
                break
            full = full * (most / moving)
            speed = np.clip(full, before - rise, before + rise)
        return np.asarray(speed)

    def _changes(self, values: Array, positions: Array, at: Configuration) -> Array:
        """Changes of the joints (n,) in rad that an action means."""
        control = self.control
        if self.mode == "joint":
            steps = np.array(control["joint_step"])
            return np.asarray(steps * values[: len(steps)])
        lowest = self._lowest(at)
        place = self._inside(at.position + control["tool_step"] * values[:3], lowest)
        if self.mode == "cartesian":
            yaw = control["home_yaw"]
            if control["yaw"]:
                yaw = float(np.arctan2(at.rotation[1, 0], at.rotation[0, 0])) + control["yaw_step"] * values[3]
            k, s = np.cos(yaw), np.sin(yaw)
            rotation = np.array([[k, s, 0.0], [s, -k, 0.0], [0.0, 0.0, -1.0]])  # the tool points down
        else:
            place, rotation = self._changed(at, at.position, at.rotation, values, lowest)
        changes = self._towards(at, positions, place, rotation)
        near = place[2] < lowest + control["tool_step"] / 2  # as in training
        if near and place[2] < (raised := lowest + self._sinks(at, positions, changes)):
            changes = self._towards(at, positions, np.array([*place[:2], raised]), rotation)
        return changes

    def _towards(self, at: Configuration, positions: Array, place: Array, rotation: Array) -> Array:
        """Changes of the joints (n,) in rad towards a pose, scaled down so that no joint exceeds its step."""
        posture = self.control["posture_gain"] * (self.home - positions)
        changes: Array = self.chain.step(at, place, rotation, posture)
        slowed: Array = changes / max(1.0, float(np.abs(changes / self.control["joint_step"]).max()))
        return slowed

    def _sinks(self, at: Configuration, positions: Array, changes: Array) -> float:
        """How far in m the tool comes to rest below a straight way: `Control` of karolos."""
        half, speeds = self.period / 2, self.velocities + changes / self.period
        end = self.chain.at(positions + half * speeds).position[2]
        return float(2 * (at.position[2] + half * at.jacobian[2] @ speeds - end))

    def _changed(
        self, at: Configuration, place: Array, rotation: Array, values: Array, lowest: float
    ) -> tuple[Array, Array]:
        """The pose that an action makes of this one."""
        shift, turn = self.control["tool_step"] * values[:3], self.control["turn_step"] * values[3:6]
        if self.control["frame"] == "tool":
            shift, turn = at.rotation @ shift, at.rotation @ turn
        return self._inside(place + shift, lowest), self._turns.nearest(turned_by(turn) @ rotation)

    def _inside(self, place: Array, lowest: float) -> Array:
        """The nearest place in the workspace that is not below `lowest`."""
        found: Array = np.clip(place, [*self.low[:2], lowest], self.high)
        return found

    def _lowest(self, at: Configuration) -> float:
        """Lowest height to aim at, so that the tool comes to rest at the lower end of the workspace and not below."""
        z, falling = float(at.position[2]), min(float(at.jacobian[2] @ self.velocities), 0.0)
        low, steps = float(self.low[2]), float(self.control["steps_down"])
        return float(max(low, z - (z - low + falling * self.period / 2) / steps))

    def _plan_spring(self, values: Array, at: Configuration) -> None:
        """Move the set point, at most the largest error away from the tool before and after."""
        self._cut(at)
        self._spring_from = self._place, self._rotation
        self._place, self._rotation = self._changed(at, self._place, self._rotation, values, float(self.low[2]))
        self._cut(at)

    def _cut(self, at: Configuration) -> None:
        error = self.set_point_from(at)
        self._place, self._rotation = at.position + error[:3], turned_by(error[3:]) @ at.rotation


def shortened(vector: Array, most: float) -> Array:
    """The vector, no longer than this."""
    found: Array = vector * min(1.0, most / max(float(np.linalg.norm(vector)), 1e-12))
    return found
