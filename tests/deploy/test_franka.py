"""The driver `franka` against franky-sim, which speaks the wire protocol of libfranka over MuJoCo.

It has no reflexes: that none would come is seen from what is asked of the joints, which stays within the limits. The
tests need franky-control (`karolos-deploy[franka]`), and `franky-sim` on PATH, which may be of another environment.
"""

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from karolos_deploy import Bundle, Executor, Reading, SetPoint
from karolos_deploy.contracts import check
from karolos_deploy.drivers.franka import Franka

from karolos.export.bundle import export_bundle
from karolos.records import RunFolder
from karolos.records.shipped import FOLDER

franky = pytest.importorskip("franky", reason="franky-control is not installed")
if shutil.which("franky-sim") is None:
    pytest.skip("franky-sim is not on PATH", allow_module_level=True)
pytestmark = pytest.mark.xdist_group("franka")
HOST = "127.0.0.32"
SETTINGS = {"host": HOST, "realtime": "no"}


@pytest.fixture(scope="module")
def bundles(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of two bundles."""
    out = tmp_path_factory.mktemp("bundles")
    for name in ("panda_reach", "panda_pick"):
        export_bundle(RunFolder.open(FOLDER / name), out / name)
    return out


@pytest.fixture
def server(bundles: Path) -> Iterator[subprocess.Popen[str]]:
    """A simulated arm that stands at the start pose."""
    order = ["franky-sim", "-s", "mujoco", "--hostname", HOST]
    with subprocess.Popen(order, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        assert process.stdout is not None
        while "Press Ctrl+C" not in process.stdout.readline():
            assert process.poll() is None, "franky-sim does not start"
        home = franky.JointState([joint["home"] for joint in Bundle(bundles / "panda_pick").contract["joints"]])
        robot = franky.Robot(HOST, realtime_config=franky.RealtimeConfig.Ignore)
        robot.move(franky.JointMotion(home, relative_dynamics_factor=0.5))
        del robot
        yield process
        process.kill()


class Acted(Franka):
    """The driver, which records what it is told and what is read; cameras say what the logged episode does."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.told: list[tuple[SetPoint, Reading]] = []
        self._point: SetPoint | None = None

    def begin(self, episode: int, *, move: bool) -> list[float] | None:
        assert self._sensors is not None
        logged = self.bundle.episode()
        fields = [name for name in logged if name.startswith("measured_")]
        self._sensors.measured = {name.removeprefix("measured_"): logged[name][0] for name in fields}
        return super().begin(episode, move=move)

    def read(self) -> Reading | None:
        reading = super().read()
        if self._point is not None and reading is not None:
            self.told.append((self._point, reading))
            self._point = None
        return reading

    def send(self, point: SetPoint) -> None:
        self._point = SetPoint(np.array(point.positions), np.array(point.velocities))
        super().send(point)


@pytest.mark.usefixtures("server")
@pytest.mark.parametrize("name", ["panda_reach", "panda_pick"])
def test_the_tool_keeps_to_the_commanded_way_within_5_mm_and_joints_to_their_limits(name, bundles):
    loaded = Bundle(bundles / name)
    logged = iter(loaded.episode()["action"])
    loaded.policy = lambda _observation, _goal: next(logged)
    driver = Acted(loaded, SETTINGS)
    executor = Executor(loaded, driver, rate=240)
    executor.late = 1.0  # a busy machine is no fault here
    executor.check()
    try:
        assert executor.run(0, steps=len(loaded.episode()["action"])).steps == len(loaded.episode()["action"])
        told = np.array([loaded.chain.at(np.array(sent.positions)).position for sent, _ in driver.told])
        tool = np.array([loaded.chain.at(read.positions).position for _, read in driver.told])
        assert len(told) > 250
        away = np.linalg.norm(tool[:, None] - told, axis=2).min(1)
        assert away.max() < 0.005, "from the way"
        assert np.linalg.norm(tool - told, axis=1).max() < 0.01, "from where the tool is told to be at that time"
        assert {read.state for _, read in driver.told} == {"running"}
        speeds = np.array([sent.velocities for sent, _ in driver.told])
        fastest, strongest = (
            np.array([joint[key] for joint in loaded.contract["joints"]]) for key in ("velocity", "acceleration")
        )
        assert (np.abs(speeds).max(0) <= fastest).all()
        assert (np.abs(np.diff(speeds, axis=0)).max(0) * 240 <= strongest).all()
    finally:
        driver.close()


def test_it_keeps_what_every_driver_promises(bundles, server):
    check("franka", bundles / "panda_reach", SETTINGS, lose=lambda _: server.kill())
