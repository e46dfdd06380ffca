"""A fake controller of Universal Robots over a simulated robot. ur-rtde connects to it; it has a process of its own.

`python -m karolos.export.fake_ur BUNDLE [HOST] [NAME=VALUE ...]` listens on the controller's ports of a loopback
address: dashboard 29999, RTDE 30004, script 30003, and the Robotiq gripper's 63352. It prints the address for
requests, which also serves as a camera (`--set perception=...`). It runs no URScript: it answers registers as the
script of ur-rtde does. Force mode is the spring of training with the requested force; a real one is slower.
Protocol: the RTDE guide of Universal Robots.
"""

from __future__ import annotations

import socket
import struct
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from karolos_deploy.bundle import BundleError
from karolos_deploy.kinematics import turn_of, turned_by

from ..errors import KarolosError
from .simulated_robot import Server, SimulatedRobot, lines

VERSION = (5, 11, 0, 0)
TURN = turned_by((0.0, 0.0, np.pi))
"""Rotation from the controller's base frame to the arm's, as on a real robot."""
FORMATS = {"DOUBLE": "d", "UINT32": "I", "INT32": "i", "VECTOR6D": "6d"}
TYPES = {
    **dict.fromkeys(("runtime_state", "robot_status_bits", "safety_status_bits"), "UINT32"),
    **dict.fromkeys(("actual_q", "actual_qd", "actual_TCP_force", "actual_TCP_pose"), "VECTOR6D"),
    "external_force_torque": "VECTOR6D",
}
"""Types of variables; others are INT32 with `_int_` in their name, and DOUBLE without."""
STOPPED, PLAYING = 1, 2
READY, DONE = 1, 2
"""Values that the script of ur-rtde writes into its output register 0."""
SERVO, FORCE, STOPS, PAYLOAD, WATCHDOG, END = 11, 6, (7, 15, 16, 33, 34), 17, 35, 255
"""Commands in its input register 0."""
FAULTS = {"protective stop": 1 << 2, "emergency stop": 1 << 7}
"""Faults of the safety system and their bit."""


@dataclass
class Subscriber:
    """A connection to the RTDE port."""

    period: float = 1 / 500
    due: float = 0.0
    outputs: list[str] = field(default_factory=list)
    recipes: list[list[str]] = field(default_factory=list)
    started: bool = False


class FakeUR(Server):
    """Serves the ports of a controller. `do: fault` makes it fail, `do: repair` ends all faults."""

    def __init__(self, bundle: Path, host: str, settings: dict[str, str]) -> None:
        super().__init__(bundle, host)
        self.robot: SimulatedRobot = SimulatedRobot(bundle, settings)
        self.faults: set[str] = set()
        self.points = self.refused = 0
        """Number of followed set points, and of set points that came while the robot could not move."""
        self.payload: float = self.robot.contract["robot"]["payload"]
        self._registers: dict[str, float] = {"output_int_register_0": 0}
        self._runtime, self._watchdog, self._heard = STOPPED, 0.0, 0.0
        self._clients: dict[socket.socket, Subscriber] = {}
        self._gripper = self._stamp = 0.0
        self._late = time.perf_counter()
        self.listen(29999, self._dashboard, b"Connected: Universal Robots Dashboard Server\n")
        self.listen(30003, self._script)
        self.listen(30004, self._rtde)
        self.listen(63352, self._finger)

    def answer(self, request: dict[str, Any]) -> dict[str, Any]:
        what = request["do"]
        if what == "fault":
            self.fail(request["kind"])
            return {}
        if what == "repair":
            self.faults.clear()
            self.points = self.refused = 0
            return {}
        if what == "state":
            return {
                "points": self.points,
                "refused": self.refused,
                "speed": max(map(abs, self.robot.arm.joint_velocities)),
            }
        if what == "measured":
            return {"measured": self.robot.told()["measured"]}
        if what == "begin":
            goal = self.robot.reset(request["episode"])
            self._gripper = self.robot.arm.opening_command
            return {"goal": goal}
        return {"success": self.robot.outcome()}

    def fail(self, kind: str) -> None:
        """Simulate this fault from now on."""
        self.faults.add(kind)
        if kind in FAULTS:
            self._end_program()
        if kind == "controller restarted":
            self._late = time.perf_counter() - self.robot.time
            self.restarted = time.perf_counter()
            self._end_program()
        for connection in list(self._clients) if kind in ("connection cut", "half a packet") else ():
            if kind == "half a packet":
                packet = self._packet(self._clients[connection])
                connection.sendall(packet[: len(packet) // 2])
            del self._clients[connection]
            self.forget(connection)

    def forget(self, connection: socket.socket) -> None:
        if self._clients.pop(connection, None) is not None:
            self._end_program()
        elif connection.fileno() >= 0:
            self._selector.unregister(connection)
            connection.close()
            return
        super().forget(connection)

    def _end_program(self) -> None:
        self._runtime = STOPPED
        self._registers["output_int_register_0"] = 0
        self.robot.stop()

    def tick(self) -> None:
        super().tick()
        now = time.perf_counter()
        if self._runtime == PLAYING and self._watchdog and now - self._heard > 1 / self._watchdog:
            self._end_program()
        for connection, client in list(self._clients.items()):
            if client.started and now >= client.due and "late reading" not in self.faults:
                client.due = max(client.due + client.period, now - client.period)
                try:
                    connection.sendall(self._packet(client))
                except OSError:
                    self.forget(connection)

    def _packet(self, client: Subscriber) -> bytes:
        """A data package with the outputs that a client requested."""
        told, robot, faults = self.robot.told(), self.robot, self.faults
        stamp = self._stamp = max(self._stamp, told["time"] + time.perf_counter() - self._late - robot.time)
        positions = np.array(told["positions"])
        if "jump" in faults:
            positions = positions + 0.5
        if "not a number" in faults:
            positions = positions * np.nan
        if "controller restarted" in faults:
            stamp = time.perf_counter() - self.restarted
        tool = robot.arm.tool
        rotation = np.stack([tool.x, tool.y, tool.z], 1)
        back = TURN.T @ rotation
        force = np.concatenate([back @ told["wrench"][:3], back @ told["wrench"][3:]])
        place = TURN.T @ np.subtract(tool.position, robot.arm.base)
        values: dict[str, Any] = {
            "timestamp": 1.0 if "stale clock" in faults else stamp,
            "payload": self.payload + 2.0 * ("wrong payload" in faults),
            "runtime_state": self._runtime,
            "robot_status_bits": 3,
            "safety_status_bits": sum(bit for name, bit in FAULTS.items() if name in faults) or 1,
            "actual_q": positions,
            "actual_qd": told["velocities"],
            "actual_TCP_force": force + 500.0 * ("force" in faults),
            "actual_TCP_pose": [*place, *turn_of(back)],
        }
        if told["state"] == "protective stop":
            values["safety_status_bits"] = FAULTS["protective stop"]
        data = b"\x01"
        for name in client.outputs:
            value = values.get(name, self._registers.get(name, 0))
            form = FORMATS[_type(name)]
            data += struct.pack(">" + form, *value) if form == "6d" else struct.pack(">" + form, value)
        return struct.pack(">HB", len(data) + 3, ord("U")) + data

    def _rtde(self, connection: socket.socket, rest: bytearray) -> None:
        client = self._clients.setdefault(connection, Subscriber())
        while len(rest) >= 3 and len(rest) >= (size := struct.unpack(">H", rest[:2])[0]):
            kind, data = chr(rest[2]), bytes(rest[3:size])
            del rest[:size]
            if kind == "U":
                if data[0] <= len(client.recipes):  # a cut connection has none, and may send once more
                    self._command(client.recipes[data[0] - 1], data[1:])
                continue
            reply = b"\x01"
            if kind == "v":
                reply = struct.pack(">4I", *VERSION)
            elif kind == "O":
                client.period = 1 / struct.unpack(">d", data[:8])[0]
                client.outputs = data[8:].decode().rstrip(",").split(",")
                reply = b"\x01" + ",".join(map(_type, client.outputs)).encode()
            elif kind == "I":
                client.recipes.append(data.decode().rstrip(",").split(","))
                reply = bytes([len(client.recipes)]) + ",".join(map(_type, client.recipes[-1])).encode()
            elif kind in "SP":
                client.started = kind == "S"
            connection.sendall(struct.pack(">HB", len(reply) + 3, ord(kind)) + reply)

    def _command(self, recipe: list[str], data: bytes) -> None:
        """Read registers, and do what the script of ur-rtde does with its command."""
        if "VECTOR6D" in map(_type, recipe):
            return  # an external sensor of forces
        values = struct.unpack(">" + "".join(FORMATS[_type(name)] for name in recipe), data)
        self._registers.update(zip(recipe, values, strict=True))
        self._heard = time.perf_counter()
        command, reals = int(self._registers["input_int_register_0"]), [
            self._registers.get(f"input_double_register_{place}", 0.0) for place in range(11)
        ]  # fmt: skip
        if self._runtime != PLAYING:
            self.refused += command in (SERVO, FORCE)
            return
        self._registers["output_int_register_0"] = DONE if command not in (0, SERVO, FORCE) else READY
        if command == END:
            self._end_program()
        elif command in STOPS:
            self.robot.stop()
        elif command == WATCHDOG:
            self._watchdog = reals[0]
        elif command == PAYLOAD:
            self.payload = reals[0]
        elif command in (SERVO, FORCE):
            self.points += 1
            self.tick()
            self.robot.command(self._point(command, reals), self.robot.time)

    def _point(self, command: int, reals: list[float]) -> dict[str, Any]:
        """The set point of a simulated robot."""
        if command == SERVO:
            return {"positions": reals[:6], "velocities": [0.0] * 6, "lookahead": reals[9], "opening": self._gripper}
        spring, tool = self.robot.contract["control"]["spring"], self.robot.arm.tool
        wrench = [self._registers[f"input_double_register_{place}"] for place in range(6, 12)]
        shift = TURN @ wrench[:3] / spring["stiffness"]
        turn = turned_by(TURN @ wrench[3:] / spring["turn_stiffness"])
        rotation = turn @ np.stack([tool.x, tool.y, tool.z], 1)
        place = [*np.add(tool.position, shift)]
        return {"place": place, "rotation": rotation, "velocity": [0.0] * 6, "opening": self._gripper}

    def _script(self, _: socket.socket, rest: bytearray) -> None:
        if b"end" in lines(rest) and not self.faults & set(FAULTS):  # the last line of the program, not indented
            self._runtime, self._watchdog = PLAYING, 0.0
            self._registers["output_int_register_0"] = READY
            self.robot.state = "running"

    def _dashboard(self, connection: socket.socket, rest: bytearray) -> None:
        model = "UR10" if "wrong robot" in self.faults else self.robot.contract["robot"]["name"].upper()
        known = {b"PolyscopeVersion": "URSoftware 5.11.0.0", b"get serial number": "20210000000"}
        known |= {b"get robot model": model, b"is in remote control": "true"}
        for line in lines(rest):
            if line == b"stop":
                self._end_program()
            connection.sendall(known.get(line, "ok").encode() + b"\n")

    def _finger(self, connection: socket.socket, rest: bytearray) -> None:
        for line in lines(rest):
            words = line.split()
            if words[0] == b"SET":
                self._gripper = 1 - int(words[2]) / 255
            place = round(255 * (1 - self.robot.told()["opening"]))
            connection.sendall(b"ack\n" if words[0] == b"SET" else f"POS {place}\n".encode())


def _type(name: str) -> str:
    """The type of a variable or register."""
    return TYPES.get(name, "INT32" if "_int_" in name else "DOUBLE")


def main(arguments: list[str]) -> None:
    """Serve until stdin ends."""
    if not arguments or arguments[0].startswith("-"):
        sys.exit(__doc__)
    bundle, host, *others = [*arguments, "127.0.0.1"][: max(2, len(arguments))]
    try:
        server = FakeUR(Path(bundle), host, dict(one.split("=", 1) for one in others))
    except (BundleError, KarolosError, OSError) as error:
        sys.exit(str(error))
    server.serve()


if __name__ == "__main__":
    main(sys.argv[1:])
