"""What every engine promises to robots and tasks. Each test runs once per installed engine."""

import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from karolos_cli.main import app
from support import rig
from support.rig import ENGINES, made
from typer.testing import CliRunner

from karolos.errors import KarolosError, PluginError, UsageError
from karolos.robots.panda import Panda
from karolos.simulation import engines, urdf
from karolos.simulation.engines import Engine, make_world
from karolos.simulation.interface import Body, Camera, JointLimits, Material, Motors, Stroke, World
from karolos.simulation.parts import Mechanism
from karolos.simulation.shapes import Capsule, Cuboid, Inertia, Sphere, inertia_of, volume_of
from karolos.specification import spec_from_dict

PENDULUM = """
<robot name="pendulum"><link name="base"/>
  <link name="arm"><inertial><origin xyz="0.5 0 0"/><mass value="2"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="20" velocity="2"/></joint></robot>
"""
WEIGHT = 2 * 9.81 * 0.5  # N m about the hinge


@pytest.fixture(params=ENGINES)
def engine(request: pytest.FixtureRequest) -> Engine:
    return request.param


@pytest.fixture
def world(engine: Engine) -> Any:
    return rig.world(engine)


@pytest.fixture(params=[1, 10])
def divided(engine: Engine, request: pytest.FixtureRequest) -> World:
    """A world with 1 or 10 physics steps per control step."""
    return rig.world(engine, substeps=request.param)


def test_what_presses_on_a_body_is_known_by_link_and_body(world):
    lower, upper = (world.body([Cuboid((0.1, 0.1, 0.1))], mass, (1, 0, 0, 1)) for mass in (2.0, 1.0))
    lower.place((0.0, 0.0, 0.05))
    upper.place((0.0, 0.0, 0.15))
    for _ in range(24):
        world.step()
    pressing = world.forces(lower)
    floor = next(other for _, other in pressing if other != upper.index)
    assert pressing == pytest.approx({(-1, floor): 3 * 9.81, (-1, upper.index): 9.81}, rel=0.05)
    upper.place((0.0, 0.0, 3.0))
    world.step()
    assert world.forces(upper) == {}


def test_a_falling_body_falls_as_it_must(divided):
    box = divided.body([Cuboid((0.1, 0.1, 0.1))], 1.0, (1, 0, 0, 1))
    box.place((0.0, 0.0, 5.0))
    for _ in range(120 // divided.substeps):
        divided.step()
    assert box.pose()[0][2] == pytest.approx(5 - 9.81 * (0.5**2 / 2 + 0.5 * divided.lead), abs=1e-4)


def pendulum(world: World, effort: float, speed: float = 2.0) -> tuple[Body, Motors]:
    """A pendulum held horizontally, far above the floor."""
    body = world.load(Mechanism(urdf.ElementTree.fromstring(PENDULUM)), position=(0.0, 0.0, 3.0))
    motors = world.motors(body, ["arm"], JointLimits((-3.0,), (3.0,), (speed,), (effort,)), None)
    motors.write([0.0], 0.0)
    return body, motors


@pytest.mark.parametrize(("share", "friction", "holds"), [(1.1, 0.0, True), (0.9, 0.0, False), (1.1, 0.2, False)])
def test_a_motor_holds_what_its_torque_allows_whatever_the_substeps(divided, share, friction, holds):
    body, motors = pendulum(divided, share * WEIGHT)
    motors.set_joint_friction(friction)
    for _ in range(48 * 10 // divided.substeps):
        divided.step()
    position, *_, torque = body.joints([0])[0]
    assert (abs(position) < 0.01) is holds
    if holds:
        assert abs(torque) == pytest.approx(WEIGHT, rel=0.01)


def test_a_motor_follows_a_ramp_of_speeds(divided):
    body, motors = pendulum(divided, 50 * WEIGHT)
    begin, end = 0.0, 1.5
    motors.drive([begin], [end], {})
    divided.step()
    position, speed, *_ = body.joints([0])[0]
    assert position == pytest.approx((begin + end) / 2 * divided.period + (end - begin) * divided.lead, rel=1e-3)
    assert speed == pytest.approx(end, rel=1e-3)


def test_damping_brakes_a_joint_as_its_law_says_whatever_the_substeps(engine):
    inertia = 0.1 + 2 * 0.5**2  # kg m2 about the hinge
    ends = []
    for substeps in (1, 10):
        world = rig.world(engine, substeps=substeps)
        world.set_gravity(0.0)
        _, motors = pendulum(world, 1.0)
        motors.set_joint_damping(0.5)
        motors.drive([1.0], [1.0], {})
        for _ in range(240 // substeps):
            world.step()
        motors.set_joint_friction(1 - 1e-9)
        for _ in range(240 // substeps):
            world.step()
        ends.append(motors.read()[1][0])
    assert ends[0] == pytest.approx(ends[1], rel=1e-6)
    assert ends[0] == pytest.approx(np.exp(-0.5 / inertia), rel=0.01)


def test_a_box_rests_on_the_floor_by_its_weight_until_it_is_taken_away(world):
    box = world.body([Cuboid((0.04, 0.04, 0.04))], 0.1, (1, 0, 0, 1))
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


@pytest.mark.parametrize(("floor", "slides"), [(0.2, True), (0.8, False)])
def test_friction_is_the_product_of_both_coefficients(world, floor, slides):
    box = world.body([Cuboid((0.04, 0.04, 0.04))], 0.1, (1, 0, 0, 1))
    box.set_friction(0.5)
    world.set_floor_friction(floor)
    angle = np.arctan(0.25)  # of the floor; the box slides if floor * 0.5 is less than its tangent
    turn = (0.0, float(np.sin(angle / 2)), 0.0, float(np.cos(angle / 2)))
    world.floor.place((0.0, 0.0, 0.0), turn)  # type: ignore[attr-defined]
    normal = np.array([np.sin(angle), 0.0, np.cos(angle)])
    x, y, z = (0.02 * normal).tolist()
    box.place((x, y, z), turn)
    for _ in range(24):
        world.step()
    assert (np.linalg.norm(np.array(box.pose()[0]) - 0.02 * normal) > 0.05) == slides


def test_a_spinning_box_has_its_angular_velocity_in_the_world(world):
    """A box that leans on its edge falls about the world's y axis, although it is turned about z."""
    box = world.body([Cuboid((0.04, 0.04, 0.04))], 0.1, (1, 0, 0, 1))
    world.set_floor_friction(5.0)
    lean, turn = np.pi / 4 + 0.1, np.pi / 2
    about_y, about_z = (
        np.array([0, np.sin(lean / 2), 0, np.cos(lean / 2)]),
        np.array([0, 0, np.sin(turn / 2), np.cos(turn / 2)]),
    )
    (x, y, z, w), (_, _, k, v) = about_y, about_z
    box.place((0.0, 0.0, 0.03), (v * x - k * y, v * y + k * x, v * z + k * w, v * w - k * z))
    for _ in range(3):
        world.step()
    across, along, upright = box.velocity()[1]
    assert abs(across) > 1
    assert abs(along) < 0.1 * abs(across)
    assert abs(upright) < 0.1 * abs(across)


def test_a_link_has_the_frame_and_the_speed_of_its_joint(world):
    body, motors = pendulum(world, 50 * WEIGHT)
    motors.drive([1.0], [1.0], {})
    world.step()
    angle, speed, *_ = body.joints([0])[0]
    state = body.link(0)
    assert state.position == pytest.approx((0.0, 0.0, 3.0), abs=1e-6)
    assert state.centre == pytest.approx((0.5 * np.cos(angle), 0.0, 3 - 0.5 * np.sin(angle)), abs=1e-5)
    assert state.angular_velocity == pytest.approx((0.0, speed, 0.0), abs=1e-5)
    assert state.velocity == pytest.approx((-0.5 * speed * np.sin(angle), 0, -0.5 * speed * np.cos(angle)), abs=1e-5)
    assert state.orientation == pytest.approx((0, np.sin(angle / 2), 0, np.cos(angle / 2)), abs=1e-5)


def test_a_body_that_is_added_later_leaves_the_others_as_they_are(world):
    first = world.body([Cuboid((0.04, 0.04, 0.04))], 0.1, (1, 0, 0, 1))
    first.place((0.4, 0.0, 1.0))
    first.set_inertia(0.3, (0.1, 0.2, 0.3))
    world.step()
    pose, velocity = first.pose(), first.velocity()
    second = world.body([Cuboid((0.04, 0.04, 0.04))], 0.1, (1, 0, 0, 1))
    second.place((1.4, 0.0, 1.0))
    assert (first.pose(), first.velocity()) == (pose, velocity)
    world.step()
    assert second.pose()[0][2] < 1.0


def test_a_body_of_several_shapes_has_their_centre_of_mass_and_its_own_frame(world):
    """An L: its frame is at one end of it."""
    arms = [Cuboid((0.1, 0.02, 0.02), position=(0.05, 0, 0)), Cuboid((0.02, 0.02, 0.1), position=(0.1, 0, 0.06))]
    body = world.body(arms, 0.3, (1, 0, 0, 1))
    body.place((0.4, 0.1, 0.01))
    for _ in range(12):
        world.step()
    assert body.pose()[0] == pytest.approx((0.4, 0.1, 0.01), abs=2e-3)
    turn = (0.0, 0.6, 0.0, 0.8)
    body.place((0.4, 0.1, 0.2), turn)  # it falls on its corner, and turns
    assert (*body.pose()[0], *body.pose()[1]) == pytest.approx((0.4, 0.1, 0.2, *turn), abs=1e-6)
    for _ in range(30):
        before, speed = body.pose()[0], body.velocity()[0]
        world.step()
        moved = np.subtract(body.pose()[0], before) / world.period
        if world.forces(body) == {}:
            assert moved == pytest.approx(np.add(speed, body.velocity()[0]) / 2, abs=0.05)
    assert np.linalg.norm(np.subtract(body.pose()[1], turn)) > 0.1


def test_inertia_is_that_of_the_whole_however_it_is_cut_and_turned():
    whole = inertia_of([Cuboid((0.2, 0.1, 0.05), position=(0.1, 0.0, 0.0))], 2.0)
    half = 0.5**0.5
    cut = [
        Cuboid((0.1, 0.1, 0.05), position=(0.05, 0.0, 0.0)),
        Cuboid((0.05, 0.1, 0.1), position=(0.15, 0.0, 0.0), orientation=(0.0, half, 0.0, half)),
    ]
    assert inertia_of(cut, 2.0) == Inertia(whole.centre, pytest.approx(whole.moments))
    turned = inertia_of([Cuboid((0.2, 0.1, 0.05), orientation=(0.1, 0.2, 0.3, 0.4))], 2.0)
    assert sorted(turned.moments) == pytest.approx(sorted(whole.moments))
    assert volume_of(cut) == pytest.approx(0.001)
    ball, capsule = (inertia_of([shape], 1.0).moments for shape in (Sphere(0.1), Capsule(0.1, 1e-6)))
    assert ball == pytest.approx(capsule, rel=1e-4)
    with pytest.raises(UsageError, match="Cuboid: size"):
        Cuboid((0.1, -0.1, 0.1))


def test_a_state_that_diverged_shows_and_leaves_nothing_behind(world):
    ends = []
    box = world.body([Cuboid((0.04, 0.04, 0.04))], 0.1, (1, 0, 0, 1))
    for height in (0.3, float("nan"), 0.3):
        box.place((0.4, 0.0, height))
        for _ in range(12):
            world.step()
        ends.append(box.pose())
    assert not np.isfinite(ends[1][0]).all()
    if type(world).__module__.startswith("karolos.simulation.mujoco"):  # after NaN RobotTask builds a new world anyway
        assert ends[0] == ends[2]


def test_picture_shows_markers_and_leaves_them_where_they_are(world):
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
    for label in (None, "3 N"):
        stroke = Stroke([(0.3, -0.4, 0.2), (0.3, -0.2, 0.2)], (1.0, 0.0, 1.0, 1.0), label=label)
        assert 5 < (world.render(64, 48, camera, [stroke]) != seen).any(-1).sum() < seen.size / 20


def test_pictures_between_control_steps_show_what_moved_and_change_nothing(engine):
    filmed, other = (made("pick_place", environment={"engine": engine}) for _ in range(2))
    for environment in (filmed, other):
        environment.reset(0)
    before = filmed.render(64, 48).astype(int)
    for environment in (filmed, other):
        environment.step(np.ones(4))
    middle, after = (picture.astype(int) for picture in filmed.film(2, 64, 48))
    far, near = np.abs(after - before).sum(), np.abs(after - middle).sum()
    assert 0.2 * far < near < 0.9 * far
    one, two = (environment.step(-np.ones(4)).observation for environment in (filmed, other))
    np.testing.assert_array_equal(one, two)


def test_shadow_tells_how_high_a_body_is(world):
    camera = Camera()
    empty = world.render(160, 120, camera)
    box = world.body([Cuboid((0.06, 0.06, 0.06))], 0.1, (1.0, 0.0, 0.0, 1.0))
    rows = []
    for height in (0.12, 0.4):
        box.place((0.3, 0.0, height))
        picture = world.render(160, 120, camera).astype(int)
        red = picture[..., 0] > picture[..., 1]  # the box with its smoothed edge
        shadow = (picture.sum(-1) < empty.astype(int).sum(-1) - 60) & ~red
        rows.append((np.nonzero(red)[0].mean(), np.nonzero(shadow)[0].mean()))
    (low, low_shadow), (high, high_shadow) = rows
    assert high < low - 10
    assert abs(high_shadow - low_shadow) < 4, "it stays on the floor below"


def test_a_body_hides_the_marker_behind_it(world):
    camera = Camera(target=(0.3, 0.0, 0.3), distance=1.0, yaw=90.0, pitch=0.0)
    world.body([Cuboid((0.2, 0.2, 0.2))], 0.0, (1.0, 0.0, 0.0, 1.0)).place((0.3, 0.0, 0.3))
    marker = world.marker(0.05, (0.0, 1.0, 0.0, 1.0))

    def middle(x: float) -> list[int]:
        marker.place((x, 0.0, 0.3))
        return world.render(64, 48, camera)[24, 32].tolist()

    (red, green, _), (hidden_red, hidden_green, _) = middle(0.7), middle(-0.3)
    assert green > red
    assert hidden_red > hidden_green


def test_a_held_cube_stays_in_the_hand_while_the_arm_swings(engine):
    environment = made("pick_place", environment={"engine": engine}, arm={"control": "joint"}, start_grasped=1.0)
    environment.reset(0)
    robot, cube = environment.robot, environment.task.cube  # type: ignore[attr-defined]

    def place() -> np.ndarray:
        """The cube's position in the tool's frame."""
        tool = robot.forward(robot.joint_positions).tool
        offset: np.ndarray = np.array([tool.x, tool.y, tool.z]) @ np.subtract(cube.position, tool.position)
        return offset

    hold = np.array([0.0] * 7 + [-1.0])
    for _ in range(4):
        environment.step(hold)
    before, swing = place(), hold + np.eye(8)[0]
    for _ in range(20):
        environment.step(swing)
    assert robot.joint_velocities[0] > 2
    assert np.linalg.norm(place() - before) < 1e-3


def test_a_urdf_that_the_engine_refuses_is_a_clear_error(world):
    robot = urdf.read(Panda.model.urdf)
    for joint in robot.findall("joint"):
        child = joint.find("child")
        assert child is not None
        child.set("link", "nowhere")
    with pytest.raises(PluginError, match="cannot load"):
        world.load(Mechanism(robot))


def test_a_window_without_a_display_is_a_clear_error(engine, monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(KarolosError, match=r"no (display|window)"):
        make_world(engine, window=True)


def test_a_robot_is_described_without_an_engine_or_torch_and_the_engine_greets_nobody(engine):
    code = (
        "import sys\n"
        "import karolos.environments.build\n"
        "from karolos.environments.robot_task import RobotTask\n"
        "from karolos.robots.panda import Panda\n"
        "from karolos.tasks.reach import Reach\n"
        "make = lambda kind, **settings: kind.Settings.model_validate(settings)\n"
        f"made = RobotTask(make(RobotTask, engine='{engine}'), robot=Panda(make(Panda)), task=Reach(make(Reach)))\n"
        "assert made.signature.action.size == 3\n"
        "assert not {'pybullet', 'mujoco', 'torch'} & set(sys.modules), 'heavy'\n"
        "made.reset(0)\n"
        f"assert {{'pybullet', 'mujoco', 'torch'}} & set(sys.modules) == {{'{engines.ENGINES[engine].module}'}}\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == done.stderr == ""


def test_a_spec_with_an_engine_that_is_not_installed_is_refused_with_its_place(tmp_path, monkeypatch):
    pytest.importorskip("torch")
    monkeypatch.setitem(engines.ENGINES, "bullet", engines.BULLET._replace(module="a_module_that_nobody_has"))
    path = tmp_path / "one.yaml"
    path.write_text("robot: panda\ntask: reach\nagent: sac\nenvironment:\n  name: robot_task\n  engine: bullet\n")
    result = CliRunner().invoke(app, ["check", str(path)])
    assert result.exit_code != 0
    assert "one.yaml:6:11" in result.output
    assert "the engine bullet is not installed" in result.output
    assert "pip install pybullet" in result.output


def test_the_engine_is_mujoco_by_default_and_part_of_an_experiments_identity():
    pytest.importorskip("torch")
    parts = {"name": "x", "robot": "panda", "task": "reach", "agent": "sac"}
    one, same, other = (
        spec_from_dict({**parts, "environment": environment})
        for environment in (
            "robot_task",
            {"name": "robot_task", "engine": "mujoco"},
            {"name": "robot_task", "engine": "bullet"},
        )
    )
    assert one.hash() == same.hash() != other.hash()
    assert one.dump()["environment"]["engine"] == "mujoco"


@pytest.mark.parametrize("rate", [480, 960])
def test_finer_physics_steps_give_the_same_motion(engine, rate):
    ends = []
    for one in (240, rate):
        world = rig.world(engine, substeps=10 * one // 240, rate=one)
        _, motors = pendulum(world, 50 * WEIGHT)
        for begin, end in ((0.0, 1.0), (1.0, -1.0)):
            motors.drive([begin], [end], {})
            world.step()
        ends.append((*motors.read()[0], *motors.read()[1], world.period))
    assert ends[0] == pytest.approx(ends[1], abs=5e-3)


def test_a_lively_box_comes_back_with_its_restitution_and_a_damped_one_sinks_slowly():
    world = rig.world("mujoco", substeps=1)
    box = world.body([Cuboid((0.04, 0.04, 0.04))], 0.1, (1, 0, 0, 1))
    box.set_material(Material(restitution=0.5))
    box.place((0.0, 0.0, 0.32))
    heights = []
    for _ in range(240):
        world.step()
        heights.append(box.pose()[0][2] - 0.02)
    landed = int(np.argmin(heights[:90]))
    assert max(heights[landed:]) == pytest.approx(0.3 * 0.5**2, rel=0.15)
    deep = []
    for damping in (0.0, 2000.0):
        box.set_material(Material(stiffness=1e3, damping=damping))
        box.place((0.0, 0.0, 0.02))
        for _ in range(6):
            world.step()
        deep.append(0.02 - box.pose()[0][2])
    assert 0 < deep[1] < 0.5 * deep[0]
