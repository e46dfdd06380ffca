"""The driver `ur`: arms of Universal Robots through ur-rtde. It was never tried on hardware.

It was tried against `python -m karolos.export.fake_ur BUNDLE`. Joints follow `servoJ`. A spring at the tool is
`forceMode` with the force of the spring. If no set point comes, the controller's watchdog stops the robot.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from threading import Thread
from typing import Any, ClassVar

import numpy as np

from ..bundle import Bundle, BundleError
from ..faults import Fault
from ..kinematics import turn_of, turned_by
from ..motion import shortened
from ..readings import RUNNING, Reading, SetPoint
from . import TCP_TOLERANCE
from .sensors import SensedDriver, Sensors

VARIABLES = [
    "timestamp",
    "actual_q",
    "actual_qd",
    "actual_TCP_force",
    "actual_TCP_pose",
    "safety_status_bits",
    "runtime_state",
    "payload",
]
STATES = {7: "emergency stop", 6: "emergency stop", 5: "emergency stop", 2: "protective stop", 4: "safeguard stop"}
"""Bits of the safety status -> states."""
PLAYING = 2
"""Runtime state of a controller whose program runs."""
DECELERATION = 5.0
"""Deceleration of a controlled stop, rad/s2."""
ANSWER_SECONDS = 2.0
"""Longest time in which a controller answers a command. The client would wait and connect again for minutes."""


class UR(SensedDriver):
    """Runs the policy on an arm of Universal Robots."""

    settings: ClassVar[Mapping[str, str]] = {
        "host": "",  # of the controller
        "lookahead": "0.03",  # of servoJ, s
        "gain": "500",  # of servoJ
        "watchdog": "10",  # set points per second below which the controller stops
        "gripper": "63352",  # port of the Robotiq URCap; empty: none
        "perception": "",  # HOST:PORT of what tells the measured fields, see docs/deploy.md
        "zero_wrench": "no",  # yes: zero the wrist's sensor at the beginning, with an empty gripper
    }

    def __init__(self, bundle: Bundle, settings: Mapping[str, str]) -> None:
        super().__init__(bundle, settings)
        for name in ("lookahead", "gain", "watchdog", *["gripper"] * bool(self.values["gripper"])):
            self.number(name)  # refused before anything moves
        self._impedance = bundle.contract["control"]["mode"] == "impedance"
        self._receive: Any = None
        self._control: Any = None
        self._time = -1.0
        self._gripper: Any = None
        self._silent = False
        """Whether the controller did not answer. Every further call of the client would wait for it."""

    def connect(self) -> dict[str, Any]:
        try:
            from dashboard_client import DashboardClient  # noqa: PLC0415  (optional)
            from rtde_control import RTDEControlInterface  # noqa: PLC0415
            from rtde_receive import RTDEReceiveInterface  # noqa: PLC0415
        except ImportError:
            raise BundleError("ur-rtde is missing; pip install 'karolos-deploy[ur]'") from None
        host = self.values["host"]
        try:
            board = DashboardClient(host)
            board.connect()
            model = board.getRobotModel().strip().lower().removesuffix("e")
            board.disconnect()
            self._receive = RTDEReceiveInterface(host, self.rate, VARIABLES)
            self._control = RTDEControlInterface(host, self.rate)
            if self.values["gripper"]:
                self._gripper = socket.create_connection((host, int(self.number("gripper"))), 5).makefile("rw")
        except (RuntimeError, OSError) as error:
            raise Fault("no connection", f"{host}: {str(error).splitlines()[0]}") from None
        if self.values["zero_wrench"] == "yes":
            self._control.zeroFtSensor()
        self._calibrate()
        self._sensors = Sensors(self.values["perception"], self._grip if self._gripper is not None else None)
        return {"name": model, "joints": len(self._receive.getActualQ()), "payload": self._receive.getPayload()}

    def _calibrate(self) -> None:
        """Find the turn of the controller's base frame relative to the bundle's, about the vertical."""
        at = self.bundle.chain.at(self._receive.getActualQ())
        own, told = at.position - self.bundle.chain.base, np.array(self._receive.getActualTCPPose()[:3])
        if abs(np.hypot(*own[:2]) - np.hypot(*told[:2])) + abs(own[2] - told[2]) > TCP_TOLERANCE:
            raise self.wrong_tool("tool centre point", told, own, "set the TCP of the gripper on the controller")
        self._turn = turned_by((0.0, 0.0, np.arctan2(own[1], own[0]) - np.arctan2(told[1], told[0])))

    def _grip(self, wanted: float | None) -> float:
        """Command the gripper's opening, and read its opening."""
        if wanted is not None:
            self._say(f"SET POS {round(255 * (1 - wanted))}")
        return 1 - int(self._say("GET POS").split()[-1]) / 255

    def _say(self, command: str) -> str:
        self._gripper.write(command + "\n")
        self._gripper.flush()
        return str(self._gripper.readline())

    def begin(self, episode: int, *, move: bool) -> list[float] | None:
        goal: list[float] | None = self._sensors.begin(episode)
        time.sleep(0.3)  # until all data belong to the new episode
        if not self._control.isProgramRunning():
            self._control.reuploadScript()
            time.sleep(0.2)  # until the program waits for commands
        if move and not self._control.setWatchdog(self.number("watchdog")):
            raise Fault("refused", "the controller did not accept a watchdog")
        self._time, self._moves = -1.0, move
        return goal

    def read(self) -> Reading | None:
        receive, sensors = self._receive, self._sensors
        sensors.check(self.late)
        if not receive.isConnected():
            raise Fault("connection lost", "the controller ended it")
        stamp = receive.getTimestamp()
        bits, state = receive.getSafetyStatusBits(), RUNNING
        for bit, name in STATES.items():
            if bits >> bit & 1:
                state = name
                break
        if state == RUNNING and receive.getRuntimeState() != PLAYING:
            state = "program stopped"
        if stamp == self._time and state == RUNNING:
            return None
        self._time = stamp
        positions, velocities = np.array(receive.getActualQ()), np.array(receive.getActualQd())
        self._at = self.bundle.chain.at(positions)
        back = self._at.rotation.T @ self._turn
        wrench = (back @ np.reshape(receive.getActualTCPForce(), (2, 3)).T).T.ravel()
        return Reading(stamp, positions, velocities, wrench, sensors.opening, sensors.measured, state)

    def send(self, point: SetPoint) -> None:
        if not self._moves:
            return
        self._sensors.wanted = point.opening
        try:
            done = self._answered(self._press if point.positions is None else self._follow, point)
        except RuntimeError as error:  # the client tried to connect again
            raise Fault("connection lost", str(error).splitlines()[0]) from None
        if done:
            return
        for _ in range(20):  # the robot says why a moment later
            if not self._control.isConnected():
                raise Fault("connection lost", "the controller ended it")
            reading = self.read()
            if reading is not None and reading.state != RUNNING:
                raise Fault(reading.state, "the robot says that it does not move")
            time.sleep(0.01)
        raise Fault("refused", "the controller did not accept a set point")

    def _answered(self, call: Callable[..., Any], *arguments: Any) -> Any:
        """The result of a call of the client. Raises Fault if the controller does not answer."""
        answer: Future[Any] = Future()

        def ask() -> None:
            try:
                answer.set_result(call(*arguments))
            except RuntimeError as error:
                answer.set_exception(error)

        Thread(target=ask, daemon=True).start()
        try:
            return answer.result(ANSWER_SECONDS)
        except TimeoutError:
            self._silent = True
            raise Fault("connection lost", f"the controller did not answer for {ANSWER_SECONDS:g} s") from None

    def _follow(self, point: SetPoint) -> bool:
        """Let the joints follow a set point."""
        assert point.positions is not None
        assert point.velocities is not None
        lookahead, gain = self.number("lookahead"), self.number("gain")
        ahead = point.positions + lookahead * point.velocities  # the joints follow later by this time
        return bool(self._control.servoJ(ahead.tolist(), 0.0, 0.0, 1 / self.rate, lookahead, gain))

    def _press(self, point: SetPoint) -> bool:
        """Let the tool press with the force of a spring at the tool."""
        spring, limits = self.bundle.contract["control"]["spring"], self.bundle.contract["limits"]
        assert point.place is not None
        assert point.rotation is not None
        shift, turn = point.place - self._at.position, turn_of(point.rotation @ self._at.rotation.T)
        force = self._turn.T @ shortened(shift, spring["error_limit"]) * spring["stiffness"]
        torque = self._turn.T @ shortened(turn, spring["turn_error_limit"]) * spring["turn_stiffness"]
        speed = limits["tool_speed"] or 1.0
        wrench = [*force.tolist(), *torque.tolist()]
        return bool(self._control.forceMode([0.0] * 6, [1] * 6, wrench, 2, [speed] * 3 + [1.0] * 3))

    def stop(self) -> None:
        self._moves = False
        if self._control is None or self._silent or not self._receive.isConnected():
            return  # the client would connect again; the controller's watchdog has stopped the robot
        try:
            if self._impedance:
                self._answered(self._control.forceModeStop)
            else:
                self._answered(self._control.servoStop, DECELERATION)
        except (RuntimeError, Fault):
            pass  # the watchdog stops it

    def close(self) -> None:
        super().close()
        for one in (self._control, self._receive):
            if one is not None and not self._silent:
                one.disconnect()
        if self._gripper is not None:
            self._gripper.close()
