"""Data between executor and robot: readings, set points, and the observation that a policy gets from a reading."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .kinematics import Array, Configuration

RUNNING = "running"
"""The state of a robot that follows set points."""
OF_JOINTS = ("joint_effects", "joint_rooms", "joint_speeds", "joint_accelerations")
"""Formulas with a row for each joint. Zeros follow in fields for arms with more joints."""


@dataclass(frozen=True)
class Reading:
    """The data of a robot and its sensors at one time."""

    time: float
    """Time of the robot's clock in s."""
    positions: Array
    """Joint positions (n,) in rad."""
    velocities: Array
    """Joint velocities (n,) in rad/s."""
    wrench: Array
    """Contact wrench on the tool: force in N and torque in N m (6,) at the tool centre point, in the tool's frame,
    without the weight of the gripper."""
    opening: float = 0.0
    """Opening of the gripper: 0 closed, 1 open."""
    measured: Mapping[str, Array] = field(default_factory=dict)
    """Values of cameras and fixtures, by the name of the field."""
    state: str = RUNNING
    """State of the robot: RUNNING, or why it does not move, such as "protective stop"."""

    @classmethod
    def logged(cls, columns: Mapping[str, Array], row: int) -> Reading:
        """The reading in a row of a log or of a bundle's episode, whose columns `measured_...` are measured fields."""
        found = {name: values[row] for name, values in columns.items()}
        measured = {
            name.removeprefix("measured_"): values for name, values in found.items() if name.startswith("measured_")
        }
        time, opening = (float(np.ravel(found[name])[0]) for name in ("time", "opening"))
        return cls(time, found["positions"], found["velocities"], found["wrench"], opening, measured)


@dataclass(frozen=True)
class SetPoint:
    """Target of the robot at the end of a cycle: joints, or the set point of a spring at the tool."""

    positions: Array | None = None
    """Joint positions (n,) in rad."""
    velocities: Array | None = None
    """Joint velocities (n,) in rad/s."""
    place: Array | None = None
    """Position of the spring's set point (3,) in m."""
    rotation: Array | None = None
    """Rotation of the spring's set point (3, 3)."""
    velocity: Array | None = None
    """Velocity of the spring's set point: m/s, then rad/s (6,)."""
    opening: float | None = None
    """Opening of the gripper; None: the policy does not move it."""

    def row(self) -> list[float]:
        """Numbers for a log: 12 or 2 n, then the opening."""
        opening = np.nan if self.opening is None else self.opening
        if self.positions is not None and self.velocities is not None:
            return [*self.positions.tolist(), *self.velocities.tolist(), opening]
        assert self.place is not None
        assert self.rotation is not None
        return [*self.place.tolist(), *self.rotation.ravel().tolist(), opening]


class Observer:
    """Builds the observation of a policy from readings, by the formulas of a bundle's contract."""

    def __init__(self, contract: Mapping[str, Any]) -> None:
        self.fields: list[dict[str, Any]] = contract["observation"]
        self._tau: float = contract["wrench"]["filter"]
        self._limit: float = contract["limits"]["force"]
        self._period, self._step = 1 / contract["control"]["rate"], np.array(contract["control"]["joint_step"])
        self._lower, self._upper, self._acceleration = (
            np.array([joint[key] for joint in contract["joints"]]) for key in ("lower", "upper", "acceleration")
        )
        self.reset()

    @property
    def measured(self) -> list[str]:
        """Names of the fields that a reading must have in `measured`."""
        return [one["name"] for one in self.fields if one["formula"] == "measured"]

    def reset(self) -> None:
        """Begin an episode."""
        self.wrench = np.zeros(6)
        """Low-passed wrench."""
        self.overloaded = False
        self._time: float | None = None

    def feel(self, reading: Reading) -> None:
        """Filter the wrench of a reading. Called once per reading, at the robot's rate."""
        passed = reading.time - self._time if self._time is not None else 0.0
        self._time = reading.time
        share = 1 - np.exp(-passed / self._tau) if self._tau else 1.0
        self.wrench = self.wrench + share * (reading.wrench - self.wrench)
        self.overloaded = self.overloaded or float(np.linalg.norm(self.wrench[:3])) > self._limit

    def __call__(self, reading: Reading, at: Configuration, set_point: Array) -> np.ndarray[Any, np.dtype[np.float32]]:
        """The observation (o,).

        Args:
            at: the chain at its joint positions.
            set_point: the way from the tool to the set point of a spring (6,), m and rad; zeros without.
        """
        speed = at.jacobian @ reading.velocities
        turned = (at.rotation @ self.wrench.reshape(2, 3).T).T.ravel()
        known: dict[str, Array] = {
            "tool_position": at.position,
            "tool_velocity": speed[:3],
            "tool_angular_velocity": speed[3:],
            "tool_rotation": at.rotation.T[:2].ravel(),
            "tool_heading": at.rotation[:2, 0] / np.hypot(*at.rotation[:2, 0]),
            "gripper_opening": np.array([reading.opening]),
            "joint_positions": reading.positions,
            "joint_velocities": reading.velocities,
            "set_point": set_point,
            "wrench": self.wrench,
            "wrench_along_world": turned,
            "force_exceeded": np.array([float(self.overloaded)]),
            "joint_effects": at.jacobian.T * self._step[:, None],
            "joint_rooms": np.column_stack((reading.positions - self._lower, self._upper - reading.positions)),
            "joint_speeds": self._period * reading.velocities / self._step,
            "joint_accelerations": np.minimum(self._period**2 * self._acceleration / self._step, 1),
        }
        known = {**reading.measured, **known}  # cameras may give more, but they do not replace what the joints say
        for one in self.fields:
            known[one["name"]] = self._value(one, known)
        return np.concatenate([known[one["name"]] for one in self.fields]).astype(np.float32)

    def _value(self, one: Mapping[str, Any], known: Mapping[str, Array]) -> Array:
        formula = one["formula"]
        if formula == "difference":
            first, second = one["of"]
            return known[first] - known[second]
        if formula == "tanh":
            return np.tanh([(known[name][column] + offset) / scale for name, column, offset, scale in one["of"]])
        if formula == "joint_rooms":
            return padded((known[formula] / self._step[:, None]).clip(0, one["most"]), one["size"])
        if formula in OF_JOINTS:
            return padded(known[formula], one["size"])
        return known[one["name"] if formula == "measured" else formula]


def padded(rows: Array, size: int) -> Array:
    """The numbers of rows, one row after the other, and zeros up to `size` numbers."""
    return np.pad(rows.ravel(), (0, size - rows.size))
