"""Faults, which stop a robot: each is one line. `Watch` looks for faults in every reading."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .kinematics import Configuration
from .readings import RUNNING, Reading

BOX_MARGIN = 0.03
"""Distance in m by which the tool may leave the workspace: it overshoots when it brakes."""
JOINT_MARGIN = 0.05
"""Angle in rad by which a joint may exceed its limit."""
SEEN_JUMP, JOINT_JUMP = 0.15, 0.05
"""Largest jump of a measured position in m, and of a joint in rad beyond the way that its speed explains."""


class Fault(Exception):  # noqa: N818  (the word of those who work with robots)
    """A reason to stop.

    Args:
        kind: of the fault, in two or three words.
        what: description, in one line.
    """

    def __init__(self, kind: str, what: str) -> None:
        super().__init__(f"{kind}: {what}")
        self.kind, self.what = kind, what


class Watch:
    """Looks for faults in readings, and raises the first one.

    Args:
        late: seconds without a new reading after which the robot is stopped.
    """

    def __init__(self, contract: Mapping[str, Any], late: float) -> None:
        joints, limits = contract["joints"], contract["limits"]
        self._robot, self._start = contract["robot"], contract["start"]
        self._late, self._force = late, limits["force"]
        self._low, self._high, self._speed = (
            np.array([joint[key] for joint in joints]) for key in ("lower", "upper", "velocity")
        )
        self._box = np.array(contract["workspace"]) if contract["control"]["mode"] != "joint" else None
        self._names = [joint["name"] for joint in joints]
        self._columns = {one["name"]: (one["size"], one["unit"]) for one in contract["observation"]}
        self._measured = [one["name"] for one in contract["observation"] if one["formula"] == "measured"]
        self._before: Reading | None = None
        self._news = 0.0

    def identity(self, robot: Mapping[str, Any]) -> None:
        """Raise Fault if a driver is connected to a robot, gripper or payload for which the policy was not trained.

        `robot` leaves out facts that the driver does not know.
        """
        for key in ("name", "gripper", "joints"):
            wanted = len(self._names) if key == "joints" else self._robot[key]
            if key in robot and robot[key] != wanted:
                raise Fault("wrong robot", f"its {key} is {robot[key]}, the policy was trained for {wanted}")
        if "payload" in robot and abs(robot["payload"] - self._robot["payload"]) > 0.1:
            weight = f"gripper and load weigh {self._robot['payload']:.2f} kg"
            raise Fault("wrong payload", f"the controller is set to {robot['payload']:.2f} kg, {weight}")

    def start(self, reading: Reading) -> None:
        """Raise Fault if the robot is not at the start pose of episodes."""
        low, high = np.array(self._start)
        for name, value, least, most in zip(self._names, reading.positions, low, high, strict=True):
            if not least - 0.1 <= value <= most + 0.1:
                raise Fault(
                    "start pose", f"joint {name} is at {value:.3f} rad, episodes begin at {least:.2f} to {most:.2f}"
                )

    def look(self, reading: Reading | None, now: float) -> bool:
        """Raise Fault for a reading on which the policy must not act.

        Args:
            reading: the driver's newest one; None: no new one since the last call.
            now: of the executor's clock in s.

        Returns:
            whether it is news.
        """
        before = self._before
        if before is None:
            self._news = now
        if reading is None or (before is not None and reading.time == before.time):
            if now - self._news > self._late:
                what = f"nothing new for {1000 * (now - self._news):.0f} ms, allowed are {1000 * self._late:.0f}"
                raise Fault("late reading" if reading is None else "stale clock", what)
            if reading is None or reading.state == RUNNING:
                return False
        self._news, self._before = now, reading
        if reading.state != RUNNING:
            raise Fault(reading.state, "the robot says that it does not move")
        self._finite(reading)
        if before is not None:
            self._continues(before, reading)
        outside = (reading.positions < self._low - JOINT_MARGIN) | (reading.positions > self._high + JOINT_MARGIN)
        if outside.any():
            joint = int(outside.argmax())
            raise Fault("out of limits", f"joint {self._names[joint]} is at {reading.positions[joint]:.3f} rad")
        return True

    def tool(self, at: Configuration, wrench: np.ndarray[Any, np.dtype[np.float64]]) -> None:
        """Raise Fault if the tool is outside of the workspace, or the force on it is too large."""
        if self._box is not None:
            low, high = self._box
            if (at.position < low - BOX_MARGIN).any() or (at.position > high + BOX_MARGIN).any():
                place = " ".join(f"{value:.3f}" for value in at.position)
                raise Fault("out of workspace", f"the tool is at {place} m")
        force = float(np.linalg.norm(wrench[:3]))
        if force > self._force:
            raise Fault("force", f"{force:.1f} N at the tool, allowed are {self._force:g}")

    def _finite(self, reading: Reading) -> None:
        for name in self._measured:
            if name not in reading.measured:
                raise Fault("not measured", f"no camera or fixture gives {name}, which the policy observes")
        numbers = {"positions": reading.positions, "velocities": reading.velocities, "wrench": reading.wrench}
        numbers |= {"opening": np.array([reading.opening]), "time": np.array([reading.time])}
        numbers |= {name: reading.measured[name] for name in self._measured}
        sizes = {"positions": len(self._names), "velocities": len(self._names), "wrench": 6}
        for name, values in numbers.items():
            size = sizes.get(name) or self._columns.get(name, (np.size(values), ""))[0]
            if np.size(values) != size:
                raise Fault("wrong size", f"{name} has {np.size(values)} numbers, {size} are needed")
            if np.ndim(values) != 1:
                raise Fault("wrong size", f"{name} is no plain list of numbers")
            if not np.isfinite(values).all():
                raise Fault("not a number", f"{name} of the reading is not finite")

    def _continues(self, before: Reading, reading: Reading) -> None:
        passed = reading.time - before.time
        if passed < 0:
            raise Fault("controller restarted", f"its clock went back by {-passed:.3f} s")
        way = np.abs(reading.positions - before.positions) - self._speed * passed * 1.2
        if way.max() > JOINT_JUMP:
            joint = int(way.argmax())
            raise Fault("jump", f"joint {self._names[joint]} moved by {way[joint]:.3f} rad, faster than it can")
        for name in self._measured:  # cameras may give more
            if self._columns[name][1] == "m" and name in before.measured:
                far = float(np.linalg.norm(np.subtract(reading.measured[name], before.measured[name])))
                if far > SEEN_JUMP + 3 * passed:
                    raise Fault("jump", f"{name} moved by {far:.3f} m between two readings")
