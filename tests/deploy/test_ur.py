"""The driver `ur` against a fake controller in a process of its own, through ur-rtde, which nobody here wrote."""

import subprocess
import sys
from collections.abc import Iterator

import pytest
from karolos_deploy import Bundle, Executor, Fault
from karolos_deploy.drivers.simulation import Channel
from karolos_deploy.drivers.ur import UR
from support.bundles import bundle_of

pytest.importorskip("rtde_control", reason="ur-rtde is not installed")
pytestmark = pytest.mark.xdist_group("bundle")
HOST = "127.0.0.31"


@pytest.fixture(scope="module")
def controller() -> Iterator[str]:
    """The address of the requests of a fake controller, whose start takes longer than a test."""
    order = [sys.executable, "-m", "karolos.export.fake_ur", str(bundle_of("ur5_pick")), HOST]
    with subprocess.Popen(order, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield process.stdout.readline().strip()
        assert process.stdin is not None
        process.stdin.close()


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


def test_another_robot_and_another_payload_are_refused(whole, asked):
    for fault in ("wrong payload", "wrong robot"):
        asked.ask(do="fault", kind=fault)
        driver = UR(Bundle(whole), {"host": HOST})
        with pytest.raises(Fault, match=fault):
            Executor(Bundle(whole), driver, rate=125).check()
        driver.close()
