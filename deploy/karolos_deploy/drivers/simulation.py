"""The driver `simulation`: karolos' own simulated world as the robot, in a process of its own.

The process is `python -m karolos.export.simulated_robot BUNDLE`. It may be in another environment (`python`) or already
run somewhere (`address`). With `clock=simulated` time passes as fast as both can compute.
"""

from __future__ import annotations

import json
import re
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, ClassVar

import numpy as np

from ..bundle import Bundle, BundleError
from ..faults import Fault
from ..readings import Reading, SetPoint
from . import Driver

OWN_GROUP: Any = {"creationflags": getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0), "start_new_session": True}
"""Arguments of a process that Ctrl-C in a terminal does not reach, on every system."""


class Channel:
    """A connection with lines of JSON: a request, then its answer.

    Args:
        address: HOST:PORT.
        seconds: longest time of an answer.
    """

    def __init__(self, address: str, seconds: float = 60.0) -> None:
        self._address, self._seconds = address, seconds
        host, _, port = address.rpartition(":")
        try:
            self._socket = socket.create_connection((host, int(port)), timeout=seconds)
        except (OSError, ValueError):
            raise Fault("no connection", f"nothing answers at {address}") from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._lines = self._socket.makefile("rb")
        self._one = threading.Lock()  # an answer belongs to its request

    def ask(self, **request: Any) -> dict[str, Any]:
        """The answer to a request. Raises Fault if the other side is gone or refuses the request."""
        with self._one:
            try:
                self._socket.sendall(json.dumps(request).encode() + b"\n")
                line = self._lines.readline()
            except TimeoutError:
                raise Fault("connection lost", f"{self._address} did not answer for {self._seconds:g} s") from None
            except OSError:
                line = b""
        try:
            answer: dict[str, Any] = json.loads(line) if line.endswith(b"\n") else {"fault": "connection lost"}
        except (ValueError, RecursionError):
            answer = {"fault": "half a packet"}
        if not isinstance(answer, dict):
            answer = {"fault": "half a packet", "what": "the answer is no object of JSON"}
        if "fault" in answer:
            raise Fault(answer["fault"], answer.get("what", "the other side ended in the middle"))
        return answer

    def close(self) -> None:
        """End the connection."""
        with suppress(OSError):  # the other side may be gone
            self._socket.shutdown(socket.SHUT_RDWR)  # a thread that waits for an answer goes on
        self._lines.close()
        self._socket.close()


class Simulation(Driver):
    """Runs the policy on a simulated robot."""

    settings: ClassVar[Mapping[str, str]] = {
        "python": sys.executable,  # that has karolos installed
        "address": "",  # HOST:PORT of a simulated robot that runs already; empty: one is started
        "clock": "real",  # or simulated
        "seed": "",  # of the test episodes; empty: those of `karolos test`
        "change": "",  # settings and parameters as for `karolos test`, such as robot.latency=0.02 task.object_mass=0.2
    }

    def __init__(self, bundle: Bundle, settings: Mapping[str, str]) -> None:
        super().__init__(bundle, settings)
        if self.values["clock"] not in ("real", "simulated"):
            raise BundleError(f"clock is {self.values['clock']!r}; it is real or simulated")
        if self.values["seed"] and not re.fullmatch(r"\d{1,18}", self.values["seed"], re.ASCII):
            raise BundleError(f"seed is {self.values['seed']!r}; it is a whole number, or empty")
        self._simulated = self.values["clock"] == "simulated"
        self._process: subprocess.Popen[str] | None = None
        self._channel: Channel | None = None
        self._point: dict[str, Any] | None = None
        self._latest: dict[str, Any] | None = None

    def connect(self) -> dict[str, Any]:
        address = self.values["address"] or self._start()
        self._channel = Channel(address)
        return self._channel.ask(do="connect", **{name: self.values[name] for name in ("seed", "clock", "change")})

    def _start(self) -> str:
        command = [self.values["python"], "-m", "karolos.export.simulated_robot", str(self.bundle.folder)]
        try:
            self._process = subprocess.Popen(  # Ctrl-C in a terminal is for this process
                command, stdout=subprocess.PIPE, stdin=subprocess.PIPE, text=True, **OWN_GROUP
            )
        except OSError as error:
            raise BundleError(f"{self.values['python']} cannot be started: {error.strerror}") from None
        assert self._process.stdout is not None
        address = self._process.stdout.readline().strip()
        if not address:
            what = "the simulated robot did not start: is karolos installed there?"
            raise BundleError(f"{what} --set python=... names the Python of the environment that has it")
        return address

    def now(self) -> float:
        return self._latest["now"] if self._simulated and self._latest else super().now()

    def begin(self, episode: int, *, move: bool) -> list[float] | None:  # noqa: ARG002  (it waits for ever)
        assert self._channel is not None
        self._latest, self._point = self._channel.ask(do="reset", episode=episode), None
        goal: list[float] = self._latest["goal"]
        return goal

    def read(self) -> Reading | None:
        assert self._channel is not None
        if not self._simulated:
            self._latest = self._channel.ask(do="exchange", point=self._point)
            self._point = None
        told = self._latest
        if not told:
            return None
        measured = {name: np.array(values, float) for name, values in told["measured"].items()}
        positions, velocities, wrench = (np.array(told[name], float) for name in ("positions", "velocities", "wrench"))
        return Reading(told["time"], positions, velocities, wrench, told["opening"], measured, told["state"])

    def send(self, point: SetPoint) -> None:
        told: dict[str, Any] = {"opening": point.opening}
        for name in ("positions", "velocities", "place", "rotation", "velocity"):
            value = getattr(point, name)
            told[name] = None if value is None else value.tolist()
        self._point = told

    def wait(self, until: float) -> None:
        if not self._simulated:
            super().wait(until)
            return
        assert self._channel is not None
        self._latest = self._channel.ask(do="exchange", point=self._point, until=until)
        self._point = None

    def stop(self) -> None:
        self._point = None
        try:
            if self._channel is not None:
                self._channel.ask(do="stop")
        except Fault:
            pass  # then it stands still already

    def outcome(self) -> bool | None:
        assert self._channel is not None
        return bool(self._channel.ask(do="outcome")["success"])

    def close(self) -> None:
        if self._channel is not None:
            self._channel.close()
        if self._process is not None:
            assert self._process.stdin is not None
            self._process.stdin.close()  # it ends with its stdin
            try:
                self._process.wait(2)
            except subprocess.TimeoutExpired:
                self._process.kill()
