from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from karolos.errors import MachineError
from karolos.simulation import urdf
from karolos.simulation.bullet.body import Body
from karolos.simulation.bullet.motors import Motors
from karolos.simulation.bullet.world import World
from karolos.simulation.interface import Camera, JointLimits

PENDULUM = """
<robot name="pendulum"><link name="base"/>
  <link name="arm"><inertial><origin xyz="0.5 0 0"/><mass value="2"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="20" velocity="2"/></joint></robot>
"""
WEIGHT = 2 * 9.81 * 0.5  # N m about the hinge


@pytest.mark.parametrize("substeps", [1, 10])
def test_falling_body_falls_as_it_must(substeps: int) -> None:
    world = World(substeps=substeps)
    box = world.box((0.1, 0.1, 0.1), 1.0, (1, 0, 0, 1))
    box.place((0.0, 0.0, 5.0))
    steps = 120 // substeps
    for _ in range(steps):
        world.step()
    # semi-implicit Euler falls g t dt / 2 further than the parabola
    assert box.pose()[0][2] == pytest.approx(5 - 9.81 * (0.5**2 / 2 + 0.5 / 480), abs=1e-4)
    world.close()


def pendulum(world: World, effort: float, speed: float = 2.0) -> tuple[Body, Motors]:
    """A pendulum held horizontally, far above the floor."""
    body = world.load(urdf.ElementTree.fromstring(PENDULUM), position=(0.0, 0.0, 3.0))
    motors = world.motors(body, ["arm"], JointLimits((-3.0,), (3.0,), (speed,), (effort,)), None)
    motors.write([0.0], 0.0)
    return body, motors


@pytest.mark.parametrize("substeps", [1, 10])
@pytest.mark.parametrize(("share", "friction", "holds"), [(1.1, 0.0, True), (0.9, 0.0, False), (1.1, 0.2, False)])
def test_motor_holds_what_its_torque_allows_whatever_the_substeps(
    substeps: int, share: float, friction: float, holds: bool
) -> None:
    world = World(substeps=substeps)
    body, motors = pendulum(world, share * WEIGHT)
    motors.set_joint_friction(friction)
    for _ in range(48 * 10 // substeps):
        world.step()
    assert (abs(body.joints([0])[0][0]) < 0.01) is holds
    world.close()


@pytest.mark.parametrize("substeps", [1, 10])
def test_motor_follows_a_ramp_of_speeds(substeps: int) -> None:
    world = World(substeps=substeps)
    body, motors = pendulum(world, 50 * WEIGHT)
    begin, end = 0.0, 1.5
    motors.drive([begin], [end], None)
    world.step()
    position, speed, *_ = body.joints([0])[0]
    # the speed of a physics step is that at its end, which adds half a physics step's gain
    assert position == pytest.approx((begin + end) / 2 * world.period + (end - begin) / 2 / 240, rel=1e-3)
    assert speed == pytest.approx(end, rel=1e-3)
    world.close()


def test_motor_keeps_its_speed_limit() -> None:
    world = World()
    world.set_gravity(0.0)
    body, motors = pendulum(world, 20.0)
    for _ in range(12):
        motors.drive([3.0], [3.0], None)
        world.step()
        assert body.joints([0])[0][1] <= 2.0 * 1.01
    world.close()


def test_damping_brakes_a_joint_as_its_law_says_whatever_the_substeps() -> None:
    ends = []
    for substeps in (1, 10):
        world = World(substeps=substeps)
        world.set_gravity(0.0)
        body, motors = pendulum(world, 1e-9)
        motors.set_joint_damping(0.5)
        body.write_joints([0], [0.0], [1.0])
        for _ in range(240 // substeps):
            world.step()
        ends.append(body.joints([0])[0][1])
        world.close()
    assert ends[0] == pytest.approx(ends[1], rel=1e-6)
    inertia = 0.1 + 2 * 0.5**2  # kg m2 about the hinge
    assert ends[0] == pytest.approx(np.exp(-0.5 / inertia), rel=0.01)


def test_window_without_a_display_is_a_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(MachineError, match="no display"):
        World(window=True)


def test_resting_contact_and_friction() -> None:
    world = World()
    box = world.box((0.04, 0.04, 0.04), 0.1, (1, 0, 0, 1))
    box.place((0.4, 0.0, 0.02))
    for _ in range(24):
        world.step()
    assert box.pose()[0] == pytest.approx((0.4, 0.0, 0.02), abs=2e-3)
    contacts = world.contacts(box, world.floor, -1)
    assert sum(contact.force for contact in contacts) == pytest.approx(0.1 * 9.81, rel=0.01)
    assert all(contact.normal == pytest.approx((0, 0, 1)) for contact in contacts)
    box.place((0.4, 0.0, 0.5))
    world.step()
    assert not world.contacts(box, world.floor, -1)
    world.close()


def test_picture_shows_markers_and_leaves_them_where_they_are() -> None:
    world = World()
    camera = Camera()
    empty = world.render(64, 48, camera)
    marker = world.marker(0.1, (0.0, 1.0, 0.0, 1.0))
    marker.place((0.3, 0.0, 0.3))
    seen = world.render(64, 48, camera)
    assert seen.shape == (48, 64, 3)
    assert seen.dtype == np.uint8
    changed = (seen != empty).any(-1)
    assert 5 < changed.sum() < changed.size / 4
    assert marker.pose()[0] == (0.3, 0.0, 0.3)
    world.close()


def test_shadow_tells_how_high_a_body_is() -> None:
    world = World()
    camera = Camera()
    empty = world.render(160, 120, camera)
    box = world.box((0.06, 0.06, 0.06), 0.1, (1.0, 0.0, 0.0, 1.0))
    rows = []
    for height in (0.03, 0.3):
        box.place((0.3, 0.0, height))
        picture = world.render(160, 120, camera).astype(int)
        red = picture[..., 0] > picture[..., 1] + 60
        shadow = (picture.sum(-1) < empty.astype(int).sum(-1) - 60) & ~red
        rows.append((np.nonzero(red)[0].mean(), np.nonzero(shadow)[0].mean()))
    (low, low_shadow), (high, high_shadow) = rows
    assert high < low - 10
    assert abs(high_shadow - low_shadow) < 4, "it stays on the floor below"
    world.close()


def test_a_body_hides_the_marker_behind_it() -> None:
    world = World()
    camera = Camera(target=(0.3, 0.0, 0.3), distance=1.0, yaw=90.0, pitch=0.0)
    world.box((0.2, 0.2, 0.2), 0.0, (1.0, 0.0, 0.0, 1.0)).place((0.3, 0.0, 0.3))
    marker = world.marker(0.05, (0.0, 1.0, 0.0, 1.0))

    def middle(x: float) -> list[int]:
        marker.place((x, 0.0, 0.3))
        return world.render(64, 48, camera)[24, 32].tolist()

    (red, green, _), (hidden_red, hidden_green, _) = middle(0.7), middle(-0.3)
    assert green > red
    assert hidden_red > hidden_green
    world.close()


def test_robots_and_tasks_are_described_without_pybullet_and_torch() -> None:
    code = (
        "import sys\n"
        "from karolos.environments.robot_task import RobotTask\n"
        "from karolos.robots.panda import Panda\n"
        "from karolos.tasks.reach import Reach\n"
        "make = lambda kind: kind.Settings.model_validate({})\n"
        "made = RobotTask(make(RobotTask), robot=Panda(make(Panda)), task=Reach(make(Reach)))\n"
        "assert made.signature.action.size == 3\n"
        "assert not {'pybullet', 'torch'} & set(sys.modules), 'heavy'\n"
        "made.reset(0)\n"
        "assert 'torch' not in sys.modules\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == done.stderr == "", "pybullet's greeting must not reach the user"
