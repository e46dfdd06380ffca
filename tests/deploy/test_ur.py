"""The driver `ur` against a fake controller in a process of its own, through ur-rtde, which nobody here wrote."""

import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest
from karolos_deploy import Bundle, Executor, Fault
from karolos_deploy.drivers.simulation import Channel
from karolos_deploy.drivers.ur import UR
from support.bundles import bundle_of

pytest.importorskip("rtde_control", reason="ur-rtde is not installed")
pytestmark = pytest.mark.xdist_group("bundle")
HOST = "127.0.0.31"
COMMAND = "import sys; from karolos_deploy.command import main; sys.exit(main())"


@pytest.fixture(scope="module")
def process() -> Iterator[subprocess.Popen[str]]:
    """A fake controller, whose start takes longer than a test."""
    order = [sys.executable, "-m", "karolos.export.fake_ur", str(bundle_of("ur5_pick")), HOST]
    with subprocess.Popen(order, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield process
        assert process.stdin is not None
        process.stdin.close()


@pytest.fixture(scope="module")
def controller(process: subprocess.Popen[str]) -> str:
    """The address of its requests."""
    assert process.stdout is not None
    return process.stdout.readline().strip()


@pytest.fixture
def asked(controller: str) -> Iterator[Channel]:
    """A connection to it, without the faults of the test before."""
    channel = Channel(controller)
    channel.ask(do="repair")
    yield channel
    channel.close()


@pytest.mark.parametrize("fault", ["protective stop", "emergency stop", "connection cut", "half a packet", "force"])
def test_a_controller_that_fails_gets_no_further_set_point(fault, whole, controller, asked):
    bundle = Bundle(whole)
    driver = UR(bundle, {"host": HOST, "perception": controller, "watchdog": "1"})
    executor = Executor(bundle, driver, rate=125)
    executor.late = 2.0  # a busy machine is no fault here
    executor.check()
    moved = driver.send
    count = 0

    def send(point: object) -> None:
        nonlocal count
        count += 1
        if count == 40:
            asked.ask(do="fault", kind=fault)
        moved(point)  # type: ignore[arg-type]

    driver.send = send  # type: ignore[method-assign,assignment]
    with pytest.raises(Fault) as caught:
        executor.run(0)
    names = {"connection cut": "connection lost", "half a packet": "connection lost"}
    assert caught.value.kind == names.get(fault, fault)
    before = asked.ask(do="state")
    driver.wait(driver.now() + 0.5)
    after = asked.ask(do="state")
    assert after["points"] == before["points"] <= 60
    assert after["speed"] < 0.05
    driver.close()


@pytest.mark.skipif(sys.platform == "win32", reason="no process can be frozen")
def test_a_controller_that_freezes_ends_the_command(whole, process, controller, asked):
    order = [sys.executable, "-c", COMMAND, str(whole), "--move", "--driver", "ur"]
    given = [f"--set={one}" for one in (f"host={HOST}", f"perception={controller}", "watchdog=1")]
    with subprocess.Popen([*order, *given], stderr=subprocess.PIPE, text=True) as command:
        while asked.ask(do="state")["points"] < 10:
            assert command.poll() is None
            time.sleep(0.05)
        process.send_signal(signal.SIGSTOP)
        try:  # the client would wait for minutes
            _, told = command.communicate(timeout=20)
        finally:
            process.send_signal(signal.SIGCONT)
            command.kill()
    assert command.returncode == 3
    assert "stopped: " in told


def test_another_robot_and_another_payload_are_refused(whole, asked):
    for fault in ("wrong payload", "wrong robot"):
        asked.ask(do="fault", kind=fault)
        driver = UR(Bundle(whole), {"host": HOST})
        with pytest.raises(Fault, match=fault):
            Executor(Bundle(whole), driver, rate=125).check()
        driver.close()
