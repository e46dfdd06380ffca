"""The driver `franka`: arms of Franka Robotics through franky-control. It was never tried on hardware.

It was tried against franky-sim. franky's own loop of 1 kHz follows the commanded joint speeds, within the limits of
speed, acceleration and jerk. Without a new command the robot stops after `WATCHDOG`.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from ..bundle import Bundle, BundleError
from ..faults import Fault
from ..readings import RUNNING, Reading, SetPoint
from . import TCP_TOLERANCE
from .sensors import SensedDriver, Sensors

STATES = {"UserStopped": "emergency stop", "Reflex": "reflex", "Guiding": "guided by hand", "Other": "not ready"}
"""Modes of the robot in which it does not follow commands -> states."""
SPEED_SHARE = 0.99
"""Largest commanded fraction of the largest speed of each joint."""
CATCH_UP = 0.05
"""Time constant in s with which joints reach their set points."""
WATCHDOG = 100
"""Time in ms after the last set point at which the robot begins to stop."""
SILENCE = 0.5
"""Time in s without a change of the controller's clock after which the connection counts as lost."""
GRIPPER_SPEED = 0.1
"""m/s."""


class Franka(SensedDriver):
    """Runs the policy on an arm of Franka Robotics."""

    settings: ClassVar[Mapping[str, str]] = {
        "host": "",  # of the controller
        "realtime": "yes",  # no: this computer's kernel is not a realtime one
        "gripper": "yes",  # no: the hand is not asked
        "grasp_force": "40",  # N
        "home": "no",  # yes: move to the start pose before each episode, at a tenth of the largest speed
        "perception": "",  # HOST:PORT of what tells the measured fields, see docs/deploy.md
    }
    modes = ("joint", "cartesian", "pose")
    acceleration_share = 0.7

    def __init__(self, bundle: Bundle, settings: Mapping[str, str]) -> None:
        super().__init__(bundle, settings)
        self.number("grasp_force")  # refused before anything moves
        self._robot: Any = None
        self._hand: Any = None
        self._closing = self._closed = False
        self._busy: Any = None
        self._errors: tuple[type[Exception], ...] = ()

    def connect(self) -> dict[str, Any]:
        try:
            import franky  # noqa: PLC0415  (optional)
        except ImportError:
            raise BundleError("franky-control is missing; pip install 'karolos-deploy[franka]'") from None
        self._franky, host = franky, self.values["host"]
        self._errors = franky.Exception, franky.GripperException, franky.InvalidMotionTypeException
        config = franky.RealtimeConfig
        try:
            self._robot = franky.Robot(
                host, realtime_config=config.Enforce if self.values["realtime"] == "yes" else config.Ignore
            )
            if self.values["gripper"] == "yes":
                self._hand = franky.Gripper(host)
                self._width = self._hand.state.max_width
        except self._errors as error:
            raise Fault("no connection", f"{host}: {str(error).splitlines()[0]}") from None
        self._fastest = SPEED_SHARE * np.array(self._robot.joint_velocity_limit.get())
        state = self._robot.state
        own = self.bundle.chain.at(state.q_d).position - self.bundle.chain.base
        told = np.array(state.O_T_EE.translation)
        if np.linalg.norm(own - told) > TCP_TOLERANCE:
            raise self.wrong_tool("end effector", told, own, "set the end effector of the hand in Desk")
        self._sensors = Sensors(self.values["perception"], self._grip if self._hand is not None else None)
        return {"joints": len(state.q), "payload": state.m_total}

    def _grip(self, wanted: float | None) -> float:
        """Command the hand to close or open, and read its opening. It accepts a command only after the last one."""
        try:
            if wanted is not None:
                self._closing = wanted < 0.5
            if self._closing != self._closed and (self._busy is None or self._busy.wait(0.0)):
                self._closed, force = self._closing, self.number("grasp_force")
                if self._closing:
                    self._busy = self._hand.grasp_async(0.0, GRIPPER_SPEED, force, epsilon_outer=self._width)
                else:
                    self._busy = self._hand.move_async(self._width, GRIPPER_SPEED)
            return float(self._hand.state.width / self._width)
        except self._errors as error:
            raise OSError(str(error)) from None

    def begin(self, episode: int, *, move: bool) -> list[float] | None:
        goal: list[float] | None = self._sensors.begin(episode)
        try:
            if move and self.values["home"] == "yes":
                home = self._franky.JointState([joint["home"] for joint in self.bundle.contract["joints"]])
                self._robot.move(self._franky.JointMotion(home, relative_dynamics_factor=0.1))
            if move:
                self._turn(np.zeros(len(self.bundle.contract["joints"])))
        except self._errors as error:
            raise Fault("refused", str(error).splitlines()[0]) from None
        time.sleep(0.3)  # until all data belong to the new episode
        self._moves = move
        return goal

    def _turn(self, speeds: Any) -> None:
        """Command these joint speeds, in rad/s."""
        motion = self._franky.JointVelocityMotion(speeds.tolist(), self._franky.Duration(WATCHDOG))
        self._robot.move(motion, asynchronous=True)

    def _state(self) -> Any:
        try:
            return self._robot.state
        except self._errors as error:
            raise Fault("connection lost", str(error).splitlines()[0]) from None

    def now(self) -> float:
        """The controller's clock, which a simulated one may run slowly."""
        return float(self._state().time.to_sec())

    def wait(self, until: float) -> None:
        told, since = self.now(), time.perf_counter()
        while told < until:
            time.sleep(min(until - told, 5e-4))
            before, told = told, self.now()
            if told != before:
                since = time.perf_counter()
            elif time.perf_counter() - since > SILENCE:
                raise Fault("connection lost", "the controller's clock stands still")

    def read(self) -> Reading | None:
        self._sensors.check(self.late)
        state = self._state()
        self._positions = np.array(state.q)
        back = self.bundle.chain.at(self._positions).rotation.T
        wrench = (back @ np.reshape(state.O_F_ext_hat_K, (2, 3)).T).T.ravel()
        mode = STATES.get(state.robot_mode.name, RUNNING)
        stamp, velocities = float(state.time.to_sec()), np.array(state.dq)
        return Reading(stamp, self._positions, velocities, wrench, self._sensors.opening, self._sensors.measured, mode)

    def send(self, point: SetPoint) -> None:
        if not self._moves:
            return
        assert point.positions is not None
        assert point.velocities is not None
        self._sensors.wanted = point.opening
        try:
            way = point.positions - self._positions - point.velocities / self.rate  # it is of the end of the cycle
            self._turn(np.clip(point.velocities + way / CATCH_UP, -self._fastest, self._fastest))
        except self._errors as error:  # the last motion has failed
            reading = self.read()
            state = reading.state if reading is not None else RUNNING
            raise Fault("refused" if state == RUNNING else state, str(error).splitlines()[0]) from None

    def stop(self) -> None:
        moved, self._moves = self._moves, False
        if not moved:
            return
        try:
            self._robot.move(self._franky.JointVelocityStopMotion(), asynchronous=True)
            self._robot.join_motion(1.0)
        except self._errors:
            pass  # then it has stopped by itself

    def close(self) -> None:
        super().close()
        self._robot = self._hand = None
