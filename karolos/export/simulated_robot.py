"""A simulated world that behaves like a robot: it follows set points and sends readings, on a socket.

`python -m karolos.export.simulated_robot BUNDLE` prints the address at which it listens and ends with its stdin. The
driver `simulation` of karolos-deploy starts it.
"""

from __future__ import annotations

import gc
import json
import os
import selectors
import socket
import stat
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from karolos_deploy.bundle import Bundle

from ..environments.robot_task import RobotTask
from ..errors import KarolosError
from ..evaluation.changed_spec import changed_spec
from ..evaluation.policies import environment_of, signature_of
from ..evaluation.testing import test_seeds
from ..robots.arm import Arm
from ..simulation.geometry import quaternion_of
from ..specification import spec_from_dict
from ..system.files import read_object

TICK = 1 / 240
"""Period of the robot's own loop, and of a step of its world, in s."""
AHEAD = 0.02
"""Time in s for which the last set point's speed is kept if the next one is late."""
CATCH_UP = 4 * TICK
"""Time constant in s with which joints reach their set points."""
LONGEST_LAG = 0.25
"""Largest lag of the world behind the clock in s; time beyond it is skipped."""


class SimulatedRobot:
    """The robot of a bundle in the world of its task.

    Args:
        settings: `seed` and `change`, as the driver `simulation` says.
    """

    def __init__(self, bundle: Path, settings: Mapping[str, str]) -> None:
        self.contract: dict[str, Any] = Bundle(bundle).contract
        saved = spec_from_dict(read_object(bundle / "spec.json") or {})
        spec = changed_spec(saved, settings.get("change", "").split(), trained=signature_of(saved))
        environment = environment_of(spec.having("environment", substeps=1), randomize=True)
        assert isinstance(environment, RobotTask)
        arm: object = environment.robot
        assert isinstance(arm, Arm)
        self.environment, self.arm, self.task = environment, arm, environment.task
        seed = settings.get("seed") or spec.testing.seed
        self._seeds = test_seeds(int(seed), 1_000_000)
        self.world = environment.world  # building it gives the arm its motors
        self.arm.motors.set_wrench_filter(0.0)  # the executor filters
        self.measured = [one["name"] for one in self.contract["observation"] if one["formula"] == "measured"]
        self._spring = self.contract["control"]["mode"] == "impedance"
        self.time = 0.0
        """Time of the robot's clock, which also runs between episodes."""
        self.reset(0)

    def reset(self, episode: int) -> list[float]:
        """Begin a test episode; returns its goal."""
        self.environment.reset(self._seeds[episode])
        self._generator = np.random.default_rng(self._seeds[episode])
        self._latency, self._jitter = self.arm.value("latency"), self.arm.value("jitter")
        self._point: Mapping[str, Any] | None = None
        self._due = self.time
        self.state = "running"
        self._told: deque[tuple[float, dict[str, Any]]] = deque([(-np.inf, self._reading())])
        goal: list[float] = self.task.goal.tolist()
        return goal

    def command(self, point: Mapping[str, Any] | None, due: float) -> None:
        """Follow a set point for the time `due`. None: no set point came, continue as before."""
        if point is not None and self.state == "running":
            self._point, self._due = point, due

    def stop(self) -> None:
        """Brake, and ignore set points for the rest of this episode."""
        self.state, self._point = "stopped", None

    def advance(self, until: float) -> None:
        """Simulate up to a time of the robot's clock."""
        while self.time + TICK / 2 < until:
            self._move()
            self.world.step()
            self.arm.read()
            self.task.read()
            self.time += TICK
            if self.arm.stopped and self.state == "running":
                self.state = "protective stop"
                self._point = None
            at = self.time + self._latency + self._jitter * self._generator.uniform()
            self._told.append((max(at, self._told[-1][0]), self._reading()))

    def told(self) -> dict[str, Any]:
        """The newest reading that has arrived."""
        while len(self._told) > 1 and self._told[1][0] <= self.time + TICK / 4:
            self._told.popleft()
        return {**self._told[0][1], "state": self.state}

    def outcome(self) -> bool:
        """Whether the goal is reached now."""
        return bool(self.task.goal_rule.success(self.task.achieved(), self.task.goal)) and not self.arm.stopped

    def _move(self) -> None:
        """Drive the motors for one tick."""
        arm, point, size = self.arm, self._point, self.arm.chain.size
        opening = None if point is None else point["opening"]
        arm.opening_command = arm.opening_command if opening is None else opening
        openings = {0: arm.opening_command} if self.task.uses_gripper else {}
        if self._spring:
            arm.motors.drive(np.zeros((2, size)), openings)
            if point is not None:
                left = max(self._due - self.time, 0.0)
                speed = np.array(point["velocity"]) * (left > 0)
                x, y, z = (np.array(point["place"]) - left * speed[:3]).tolist()
                a, b, c, d, e, f = speed.tolist()
                arm.motors.aim((x, y, z), quaternion_of(np.array(point["rotation"])), (a, b, c), (d, e, f))
            return
        if point is None:
            slower = np.array(arm.limits.velocity) * TICK * 24
            speed = np.sign(arm.joint_velocities) * np.maximum(np.abs(arm.joint_velocities) - slower, 0.0)
        else:
            ahead = min(self.time + TICK - self._due, AHEAD)
            target = np.array(point["positions"]) + ahead * np.array(point["velocities"])
            speed = np.array(point["velocities"]) + (target - arm.joint_positions) / point.get("lookahead", CATCH_UP)
            speed = np.clip(speed, *np.outer((-1, 1), arm.limits.velocity))
        arm.motors.drive(np.array((speed, speed)), openings)

    def _reading(self) -> dict[str, Any]:
        arm, task = self.arm, self.task
        arm.observe()  # the task's observation has the same noise
        seen = np.array(task.observe())
        measured = {}
        for name in self.measured:
            measured[name] = seen[task.observation.slice(name)].tolist()
        return {
            "time": self.time,
            "positions": arm.with_noise(arm.joint_positions.tolist()),
            "velocities": arm.joint_velocities.tolist(),
            "wrench": list(arm.wrench),
            "opening": arm.opening,
            "measured": measured,
            "state": "running",
        }


def lines(rest: bytearray) -> Iterator[bytes]:
    """Remove the complete lines at the beginning of a buffer and return them."""
    while (end := rest.find(b"\n")) >= 0:
        line = bytes(rest[:end])
        del rest[: end + 1]
        yield line


class Server:
    """Listens on sockets, answers requests, and runs a simulated robot in real time, in one thread."""

    def __init__(self, bundle: Path, host: str = "127.0.0.1") -> None:
        self.bundle, self.host = bundle, host
        self.robot: SimulatedRobot | None = None
        self.real = True
        self._late = 0.0
        self._running = True
        self._selector = selectors.DefaultSelector()
        self.port = self.listen(0, self.answer_lines)

    def listen(self, port: int, eat: Callable[[socket.socket, bytearray], None], greet: bytes = b"") -> int:
        """Let `eat` consume complete messages from the bytes of each connection to a port. Returns the port."""
        waiting = socket.create_server((self.host, port))

        def accept(_: socket.socket) -> None:
            connection, _address = waiting.accept()
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.sendall(greet)
            rest = bytearray()

            def receive(connection: socket.socket) -> None:
                try:
                    data = connection.recv(65536)
                    rest.extend(data)
                    eat(connection, rest)
                except OSError:
                    data = b""
                if not data:
                    self.forget(connection)

            self.watch(connection, receive)

        self.watch(waiting, accept)
        return int(waiting.getsockname()[1])

    def watch(self, one: Any, ready: Callable[[Any], None]) -> None:
        """Call `ready` whenever a socket can be read."""
        self._selector.register(one, selectors.EVENT_READ, ready)

    def forget(self, connection: socket.socket) -> None:
        """A connection has ended: the robot stops."""
        if connection.fileno() >= 0:
            self._selector.unregister(connection)
            connection.close()
        if self.robot is not None:
            self.robot.stop()

    def answer_lines(self, connection: socket.socket, rest: bytearray) -> None:
        """Answer the requests of the driver `simulation`: a line of JSON each."""
        for line in lines(rest):
            try:
                told = self.answer(json.loads(line))
            except KarolosError as error:
                told = {"fault": "refused", "what": str(error)}
            connection.sendall(json.dumps(told).encode() + b"\n")

    def answer(self, request: dict[str, Any]) -> dict[str, Any]:
        """The answer to a request."""
        what = request.pop("do")
        if what == "connect":
            self.real = request.pop("clock") == "real"
            self.robot = SimulatedRobot(self.bundle, request)
            self._late = time.perf_counter() - self.robot.time
            return dict(self.robot.contract["robot"]) | {"joints": self.robot.arm.chain.size}
        assert self.robot is not None
        robot = self.robot
        if what == "reset":
            goal = robot.reset(request["episode"])
            self._late = time.perf_counter() - robot.time
            return {**robot.told(), "goal": goal, "now": robot.time}
        if what == "exchange":
            if self.real:
                self.tick()
                robot.command(request["point"], robot.time + TICK)
                return robot.told()
            robot.command(request["point"], request["until"])
            robot.advance(request["until"])
            return {**robot.told(), "now": request["until"]}
        if what == "stop":
            robot.stop()
        return {"success": robot.outcome()}

    def tick(self) -> None:
        """Let the world catch up with the clock."""
        if self.robot is None or not self.real:
            return
        now = time.perf_counter() - self._late
        if now - self.robot.time > LONGEST_LAG:
            self._late += now - self.robot.time - LONGEST_LAG
        self.robot.advance(now)

    def serve(self) -> None:
        """Print the address, and answer until the process at the other end of stdin closes it."""
        if stat.S_ISFIFO(os.fstat(0).st_mode):  # neither a terminal nor the null device of a service
            threading.Thread(target=self._end_with_stdin, daemon=True).start()
        print(f"{self.host}:{self.port}", flush=True)
        gc.collect()
        gc.freeze()  # a later garbage collection of all imports would take 90 ms
        while self._running:
            for key, _ in self._selector.select(TICK / 2 if self.real else 0.1):
                key.data(key.fileobj)
            self.tick()

    def _end_with_stdin(self) -> None:
        while os.read(0, 1024):
            pass
        self._running = False


if __name__ == "__main__":
    Server(Path(sys.argv[1])).serve()
