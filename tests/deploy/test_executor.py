"""The executor: it stops for each fault with one line, sends nothing after it, and writes a log that replays."""

import json
import os
import signal
import socket
import socketserver
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from karolos_deploy import Bundle, BundleError, Executor, Fault, Reading, command
from karolos_deploy.bundle import write_sums
from karolos_deploy.drivers.franka import Franka
from karolos_deploy.drivers.sensors import Sensors
from karolos_deploy.drivers.simulation import Channel, Simulation
from karolos_deploy.drivers.ur import UR
from karolos_deploy.executor import read_log, replay
from support.drivers import BROKEN, Obedient

pytestmark = pytest.mark.xdist_group("bundle")  # which a process makes once


def driven_by(kind: type[Obedient], monkeypatch: pytest.MonkeyPatch) -> list[Obedient]:
    """The drivers that commands use from now on, as soon as they use them."""
    made: list[Obedient] = []

    def make(*given: Any) -> Obedient:
        made.append(kind(*given))
        return made[-1]

    monkeypatch.setattr(command, "find", lambda _: make)
    return made


@pytest.mark.parametrize("fault", [*Obedient.failing, *Obedient.identities])
def test_each_fault_stops_the_robot_with_one_line_and_nothing_is_sent_afterwards(fault, whole, monkeypatch, capsys):
    made = driven_by(Obedient, monkeypatch)
    code = command.main([str(whole), "--move", "--rate", "125", "--set", f"fault={fault}"])
    assert code == command.STOPPED
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"stopped: {fault}: ")
    if fault in Obedient.failing:
        late = {"late reading": 11, "stale clock": 11, "out of workspace": 60, "force": 2}.get(fault, 0)  # cycles
        assert BROKEN <= len(made[0].sent) <= BROKEN + late
        assert made[0].stops == 1
    else:
        assert not hasattr(made[0], "sent")


class Camera(socketserver.StreamRequestHandler):
    """Cameras that answer twice as they should, then once with `answer`, then never."""

    answer, good = "", '{"measured": {"object_position": [0.1, 0.2, 0.3], "temperature": [20]}}'

    def handle(self) -> None:
        for answer in (self.good, self.good, self.answer or self.good):
            if not self.rfile.readline():
                return
            self.wfile.write(answer.encode() + b"\n")
        self.rfile.read()


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ("", "late reading: the cameras gave nothing new for .* ms, allowed are 50"),
        ("{}", "not measured: the cameras do not answer"),
        ('{"measured": [1]}', "not measured: the cameras do not answer"),
        ('{"measured": {"object_position": [1, [2]]}}', "not a number: object_position of the cameras is not a list"),
        ('{"measured": {"object_position": "left"}}', "not a number: object_position of the cameras is not a list"),
        (f'{{"measured": {{"object_position": [1{400 * "0"}]}}}}', "not a number: object_position of the cameras"),
        (100_000 * "[", "half a packet"),
    ],
)
def test_cameras_that_say_nothing_new_or_no_numbers_are_a_fault(answer, said):
    kind = type("Answering", (Camera,), {"answer": answer})
    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), kind) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        sensors = Sensors(f"127.0.0.1:{server.server_address[1]}", None)
        late = 60.0 if answer else 0.05

        def watch() -> None:
            for _ in range(1000):
                sensors.check(late)
                time.sleep(0.01)

        with pytest.raises(Fault, match=said):
            watch()
        server.shutdown()
        sensors.close()
        thread.join()


def test_what_cameras_give_in_addition_changes_nothing(whole, monkeypatch, capsys):
    class Talkative(Obedient):
        def read(self) -> Reading | None:
            told = super().read()
            assert told is not None
            return replace(
                told, measured={**told.measured, "tool_position": np.ones(3) * self.time, "heat": np.ones(1)}
            )

        def outcome(self) -> bool | None:
            assert self.stops == 1  # the robot stands still before cameras are asked, which may answer late
            return None

    actions = []
    for kind in (Obedient, Talkative):
        driven_by(kind, monkeypatch)
        assert command.main([str(whole), "--rate", "125"]) == 0
        actions.append(capsys.readouterr().out)
    assert actions[0] == actions[1]


def test_a_reader_that_ends_stops_the_robot_with_one_line(whole):
    code = "import sys; from karolos_deploy import command; from support.drivers import Obedient; "
    code += "command.find = lambda _: Obedient; sys.exit(command.main())"
    read, write = os.pipe()
    os.close(read)
    arguments, path = [sys.executable, "-c", code, str(whole), "--move"], Path(__file__).parents[1]
    done = subprocess.run(
        arguments, stdout=write, stderr=subprocess.PIPE, text=True, cwd=path, check=False, timeout=120
    )
    os.close(write)
    assert (done.returncode, done.stderr) == (command.STOPPED, "stopped: nobody reads the output\n")


@pytest.mark.parametrize("name", [name for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)])
def test_a_signal_stops_the_robot_with_one_line(name, whole, monkeypatch, capsys):
    handler = signal.default_int_handler if name == "SIGINT" else signal.SIG_DFL
    inherited = signal.signal(getattr(signal, name), handler)  # under nohup it is ignored, and then left so

    class Signalled(Obedient):
        def send(self, point: Any) -> None:
            super().send(point)
            if len(self.sent) == BROKEN:
                signal.raise_signal(getattr(signal, name))

    made = driven_by(Signalled, monkeypatch)
    assert command.main([str(whole), "--move", "--rate", "125"]) == command.STOPPED
    assert capsys.readouterr().err == "stopped: you asked for it\n"
    assert (len(made[0].sent), made[0].stops) == (BROKEN, 1)
    assert signal.signal(getattr(signal, name), inherited) is handler


def test_a_log_that_cannot_be_written_stops_the_robot_with_one_line(whole, tmp_path):
    driver = Obedient(Bundle(whole), {})
    executor = Executor(driver.bundle, driver, rate=125, log=tmp_path / "log")
    log = executor._log
    assert log is not None
    log._file.close()
    log._file = (tmp_path / "log").open("rb", buffering=0)  # as full as a disk can be
    with pytest.raises(Fault, match=r"no log: .*log cannot be written: "):
        executor.run()
    assert (len(driver.sent), driver.stops) == (1, 1)


@pytest.mark.parametrize("goal", [5, "abc", [[1, 2, 3]], [1, "a", 3], {}, [10**400, 0, 0]])
def test_a_goal_of_the_cameras_that_is_none_is_refused_in_one_line(goal, whole, monkeypatch, capsys):
    class Wanting(Obedient):
        def begin(self, episode: int, *, move: bool) -> Any:
            super().begin(episode, move=move)
            return goal

    driven_by(Wanting, monkeypatch)
    assert command.main([str(whole), "--move"]) == command.REFUSED
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("it needs 3 finite numbers, see the page of the bundle")


@pytest.mark.parametrize("answer", ["true", "null", "0", '"maybe"', "[]"])
def test_cameras_say_whether_an_episode_succeeds(answer):
    kind = type("Answering", (Camera,), {"answer": "", "good": f'{{"success": {answer}}}'})
    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), kind) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        sensors = Sensors("", None)
        sensors._perception = Channel(f"127.0.0.1:{server.server_address[1]}")
        if answer in ("true", "null", "0"):
            assert sensors.outcome() == json.loads(answer)
        else:
            with pytest.raises(Fault, match=r"not measured: success is .* for the cameras; it is true, false or null"):
                sensors.outcome()
        server.shutdown()
        sensors.close()
        thread.join()


def test_cameras_that_do_not_answer_are_named():
    with socket.create_server(("127.0.0.1", 0)) as waiting:
        channel = Channel(address := f"127.0.0.1:{waiting.getsockname()[1]}", 0.05)
        with pytest.raises(Fault, match=f"connection lost: {address} did not answer for 0.05 s"):
            channel.ask(do="begin")
        channel.close()


@pytest.mark.parametrize(
    ("answer", "kind"),
    [
        (b"", "connection lost"),
        (b'{"time": 1', "connection lost"),
        (b"{12\n", "half a packet"),
        (b"[1, 2]\n", "half a packet"),
    ],
)
def test_a_connection_that_is_cut_or_says_half_a_packet_is_a_fault(answer, kind):
    with socket.create_server(("127.0.0.1", 0)) as waiting:

        def serve() -> None:
            connection, _ = waiting.accept()
            connection.recv(100)
            connection.sendall(answer)
            connection.close()

        thread = threading.Thread(target=serve)
        thread.start()
        channel = Channel(f"127.0.0.1:{waiting.getsockname()[1]}")
        with pytest.raises(Fault) as caught:
            channel.ask(do="exchange")
        assert caught.value.kind == kind
        channel.close()
        thread.join()


@pytest.mark.parametrize("name", ["policy.npz", "policy.yaml", "episode.npz", "golden.npz", "README.md", "SHA256SUMS"])
def test_a_flipped_bit_is_refused_before_anything_moves(name, bundle, capsys):
    data = bytearray((bundle / name).read_bytes())
    data[len(data) // 2] ^= 1
    (bundle / name).write_bytes(data)
    assert command.main([str(bundle), "--move"]) == command.REFUSED
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("refused: ")
    assert str(bundle) in line


@pytest.mark.parametrize(
    ("name", "old", "new", "said"),
    [
        ("policy.yaml", "karolos:", "karolos: [", "ParserError: "),
        ("policy.yaml", "karolos:", "other:", "KeyError: 'karolos'"),
        ("policy.yaml", "force: 150.0", "force: 150 N", "TypeError: "),
        ("golden.npz", "PK", "PP", "ValueError: "),
    ],
)
def test_an_edited_bundle_with_right_sums_is_refused_in_one_line(name, old, new, said, bundle, capsys):
    data = (bundle / name).read_bytes()
    assert old.encode() in data
    (bundle / name).write_bytes(data.replace(old.encode(), new.encode()))
    write_sums(bundle)
    assert command.main([str(bundle), "--move"]) == command.REFUSED
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"refused: {bundle} was edited, and is no whole bundle: {said}")


def test_a_policy_that_does_not_act_as_recorded_is_refused(bundle, monkeypatch):
    golden = dict(np.load(bundle / "golden.npz"))
    np.savez(bundle / "golden.npz", **{**golden, "action": golden["action"] + 0.01})
    monkeypatch.setattr("karolos_deploy.bundle.check_sums", lambda _: None)
    with pytest.raises(BundleError, match=r"golden mismatch: golden\.npz: the action differs"):
        Bundle(bundle)


def test_a_log_of_every_cycle_gives_the_same_set_points_again(whole, tmp_path):
    loaded = Bundle(whole)
    driver = Obedient(loaded, {})
    executor = Executor(loaded, driver, rate=500, log=tmp_path / "log")
    assert [executor.run(episode).steps for episode in range(2)] == [30, 30]
    head, columns = read_log(tmp_path / "log")
    assert head["rate"] == 500
    assert len(columns["now"]) == 2 * 1250
    np.testing.assert_array_equal(columns["set_point"][-1][:6], driver.sent[-1].positions)
    assert replay(loaded, tmp_path / "log") == (2500, 0.0)
    whole_log = (tmp_path / "log").read_bytes()
    (tmp_path / "empty").write_bytes(whole_log[: whole_log.index(b"\n") + 1])
    with pytest.raises(BundleError, match="empty has no cycle: the robot was stopped before the first one"):
        replay(loaded, tmp_path / "empty")
    changed = bytearray(whole_log)
    start = changed.index(b"\n") + 1 + 8 * (3 + 3)  # the first joint in the first row
    changed[start : start + 8] = np.float64(-0.22).tobytes()
    (tmp_path / "log").write_bytes(changed)
    assert replay(loaded, tmp_path / "log")[1] > 1e-4


def test_without_move_the_policy_acts_and_nothing_is_sent(whole, monkeypatch, capsys):
    made = driven_by(Obedient, monkeypatch)
    assert command.main([str(whole)]) == 0
    assert not made[0].sent
    assert made[0].stops == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "nothing was moved; --move moves the robot"
    assert len(lines) == 1 + command.SHOWN + 1


def test_onnxruntime_acts_as_numpy_does(whole):
    pytest.importorskip("onnxruntime")
    golden = np.load(whole / "golden.npz")
    found = Bundle(whole, onnx=True).policy(golden["observation"][0], golden["desired_goal"][0])
    np.testing.assert_allclose(found, golden["action"][0], atol=1e-5)


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--set", "fault"], "--set takes NAME=VALUE"),
        (["--set", "speed=1"], "the driver has no setting speed"),
        (["--goal", "1,2", "--move"], "the goal is 1 2; it needs 3 finite numbers"),
        (["--goal", "nan,0,0", "--move"], "the goal is nan 0 0; it needs 3 finite numbers"),
        (["--rate", "5"], "a rate of 5 Hz is not possible"),
        (["--rate", "0"], "a rate of 0 Hz is not possible"),
        (["--episodes", "0"], "--episodes 0: at least 1"),
        (["--log", "none/log"], "the log none/log cannot be written: No such file"),
        (["--replay", "none/log"], "the log none/log cannot be read: No such file"),
        (["--replay", __file__], "is not a log; `--log FILE` writes one"),
        (["--driver", "kuka"], "no driver is called 'kuka'"),
    ],
)
def test_wrong_options_are_refused_in_one_line(arguments, why, whole, monkeypatch, capsys):
    if "kuka" not in arguments:
        driven_by(Obedient, monkeypatch)
    assert command.main([str(whole), *arguments]) == command.REFUSED
    (line,) = capsys.readouterr().err.splitlines()
    assert why in line


@pytest.mark.parametrize(
    ("driver", "settings", "why"),
    [
        (Simulation, {"seed": "abc"}, "seed is 'abc'; it is a whole number"),
        (UR, {"host": "x", "gain": "strong"}, "the setting gain is 'strong'; give a number"),
        (UR, {"host": "x", "lookahead": "nan"}, "the setting lookahead is 'nan'; give a number"),
        (UR, {"host": "x", "zero_wrench": "true"}, "the setting zero_wrench is 'true'; it is yes or no"),
        (Franka, {"host": "x", "grasp_force": "40N"}, "the setting grasp_force is '40N'; give a number"),
    ],
)
def test_a_setting_without_a_meaning_is_refused_before_a_connection(driver, settings, why, whole):
    with pytest.raises(BundleError, match=why):
        driver(Bundle(whole), settings)


def test_a_simulated_robot_in_a_process_of_its_own_succeeds(whole, capsys):
    change = "change=robot.latency=0.01 robot.jitter=0.002 robot.calibration_error=0.001 robot.observation_noise=0.0002"
    settings = ["clock=simulated", change]
    arguments = [part for one in settings for part in ("--set", one)]
    assert command.main([str(whole), "--move", "--json", "--rate", "125", "--episodes", "2", *arguments]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["episodes"], told["successes"]) == (2, 2)
