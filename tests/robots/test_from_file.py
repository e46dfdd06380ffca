"""The robot `urdf`: an arm from somebody's file, with the gripper that a spec names."""

import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from support.fourth_robot import LINKS, TOOL, edit
from support.spec_files import write

from karolos.errors import PluginError, UsageError
from karolos.evaluation.changed_spec import changed_spec
from karolos.evaluation.policies import signature_of
from karolos.plugins.contracts.case import candidate
from karolos.plugins.contracts.robots import reaching
from karolos.records import RunFolder
from karolos.registry import load
from karolos.robots import from_file
from karolos.robots.from_file import FromFile, proposal_of
from karolos.robots.poses import HOME_HEIGHT, _apart
from karolos.robots.repair import USUAL_SPEED, Repair
from karolos.simulation import urdf
from karolos.specification import Spec, load_spec, spec_from_dict
from karolos.system.files import copy_named, fingerprint

FILE = "{name: urdf, file: small.urdf}"


def spec_in(folder: Path, robot: str = FILE) -> Spec:
    return load_spec(
        write(folder, "reach.yaml", f"robot: {robot}\ntask: {{name: reach, reward: sparse}}\nagent: sac\n")
    )


def file_of(spec: Spec) -> str:
    assert spec.robot is not None
    return str(spec.robot.settings.model_dump()["file"])


def robot_of(file: Path, **settings: object) -> FromFile:
    return FromFile(FromFile.Settings.model_validate({"file": str(file), **settings}))


def test_a_gripper_takes_the_place_of_the_hand_in_the_file_and_closes_across(arm):
    robot = robot_of(arm, gripper="robotiq_2f85")
    links = {link.get("name") for link in robot.model.description.robot.findall("link")}
    assert "pad1" not in links
    assert {"robotiq_2f85/finger1", "robotiq_2f85/finger2"} <= links
    gripper = load("grippers", "robotiq_2f85").model
    assert robot.gripper == gripper.fingers.gripper
    assert robot.workspace.low[2] == gripper.least_height
    x, y, height = robot.configuration.tool.position
    at = round(y, 3), round(height, 3), robot.model.floor
    assert at == (0, HOME_HEIGHT, 0), "roomier homes are lower, or aside"
    assert x > 0
    assert robot.dexterous is not None
    assert all(robot.workspace.contains(end) for end in (robot.dexterous.low, robot.dexterous.high))
    assert abs(robot.configuration.tool.y[0]) < 1e-3, "the fingers close along the world's y axis"
    own = robot_of(arm)
    assert own.model.fingers is not None
    assert own.model.fingers.links == ("pad1", "pad2")
    assert abs(own.configuration.tool.y[0]) < 1e-3
    known = {"home": own.model.home, "workspace": [list(own.workspace.low), list(own.workspace.high)]}
    other = robot_of(arm, gripper="vacuum", **known)
    assert other.model.cup is not None


def test_an_arm_whose_last_joint_hardly_turns_has_no_space_in_which_its_tool_is_turned(arm):
    narrow = r'\1revolute\2 lower="-0.6" upper="0.6"'
    edit(arm, r'(?s)(name="joint6" type=")continuous(".*?<limit)', narrow)
    robot = robot_of(arm, gripper="robotiq_2f85")
    assert robot.dexterous is None
    assert any("refuse this robot" in note for note in proposal_of(robot.settings).notes)


def test_a_file_counts_by_its_content_and_stands_relative_to_the_spec(arm):
    spec, other = spec_in(arm.parent), "{name: urdf, file: other.urdf}"
    assert file_of(spec) == str(arm)
    own = spec.hash()
    moved = arm.rename(arm.parent / "other.urdf")
    assert spec_in(arm.parent, other).hash() == own
    assert set(spec_in(arm.parent, other).files()) == {"robot.file"}
    edit(moved, 'velocity="2.5"', 'velocity="2.4"')
    assert spec_in(arm.parent, other).hash() != own


def test_an_override_names_a_file_in_the_current_folder(arm, monkeypatch):
    monkeypatch.chdir(arm.parent)
    spec = load_spec("ur5_pick", ["robot.name=urdf", "robot.file=small.urdf"])
    assert file_of(spec) == str(arm)
    assert spec.dump()["robot"]["tool_step"] == 0.034, "settings of all arms stay"


def test_a_proposal_is_computed_once(arm, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    first = robot_of(arm).model
    from_file._cached.cache_clear()
    monkeypatch.setattr(from_file, "propose", None)  # not called
    assert robot_of(arm).model == first
    moved = arm.rename(arm.parent / "moved.urdf")
    assert robot_of(moved).model.urdf == moved


def test_a_missing_file_is_one_line(tmp_path):
    with pytest.raises(UsageError, match=r"robot.file: there is no file .*none.urdf; name a URDF"):
        robot_of(tmp_path / "none.urdf")


def test_what_a_person_knows_is_not_assumed(arm):
    found = robot_of(arm)
    middle = [list(found.workspace.low), list(found.workspace.high)]
    middle[1][2] -= 0.05
    place = {"home": found.model.home, "workspace": middle}
    known = robot_of(arm, **place, payload=2.0, flange="tool0", flange_yaw=0.5)
    assert known.model.home == found.model.home
    assert known.workspace.high[2] == middle[1][2]
    assert known.model.flange is not None
    assert known.model.flange.position == (0.0, 0.0, TOOL)
    with pytest.raises(Exception, match=r"weighs .* more than the payload of 0.1 kg"):
        robot_of(arm, gripper="robotiq_2f85", payload=0.1)


@pytest.mark.parametrize(
    ("known", "said"),
    [
        ({"home": [0.1, 0.2]}, "robot.home: 2 positions for the joints joint1, joint2, .*; 6 positions in rad"),
        (
            {"home": [0.0] * 6},
            r"robot.home: the tool points \S+ rad away from down; at home z of",
        ),
        (
            {"workspace": [[0.5, 0.1, 0.3], [0.3, -0.1, 0.1]]},
            "robot.workspace: no box from 0.500 .* lower corner",
        ),
        ({"tool": "tool7"}, "robot.file: .*: there is no link 'tool7'; links: "),
    ],
)
def test_a_home_workspace_or_tool_that_does_not_fit_is_refused_at_its_setting(arm, known, said):
    with pytest.raises(UsageError, match=said):
        robot_of(arm, **known)


def test_a_copy_of_a_file_and_its_meshes_is_the_same_experiment(arm, tmp_path):
    text = arm.read_text().replace("package://small_description/meshes", "../meshes")
    for path, content in {arm: text, arm.with_name("package.urdf"): arm.read_text()}.items():
        path.write_text(content)
        copy = copy_named(path, tmp_path / "copies" / path.stem)
        assert copy.parent.is_relative_to(tmp_path / "copies" / path.stem)
        assert fingerprint(copy) == fingerprint(path)
        assert not Repair(copy).findings, "each mesh is there"
        assert urdf.load(copy).joints == urdf.load(path).joints


def test_a_run_reads_its_own_copy_of_the_file(arm, tmp_path):
    spec = spec_in(arm.parent)
    own = spec.hash()
    with RunFolder.create(tmp_path / "runs", "reach", 0) as folder:
        folder.describe(spec.dump(), experiment=own, files=spec.files())
        arm.write_text("edited")
        again = spec_from_dict(folder.spec())
    assert again.hash() == own
    assert str(folder.path) in str(again.robot)


def test_episodes_of_a_slow_arm_are_longer_unless_somebody_says_how_long(arm):
    edit(arm, 'velocity="2.5"', 'velocity="0.5"')
    saved = load_spec("ur5_reach")
    trained = signature_of(saved)
    overrides = ["robot.name=urdf", f"robot.file={arm}"]
    with pytest.warns(UserWarning, match=r"times slower: \d+ control steps instead of 30"):
        spec = changed_spec(saved, overrides, trained=trained)
    slow = robot_of(arm).model.tool_step
    assert slow is not None
    assert signature_of(spec).max_steps == int(np.ceil(30 * 0.017 / slow))
    assert signature_of(changed_spec(saved, [*overrides, "task.max_steps=7"], trained=trained)).max_steps == 7


def test_no_motor_is_short_of_torque_for_the_proposed_accelerations(arm):
    edit(arm, 'effort="80"', 'effort="14"')
    model = robot_of(arm).model
    assert model.accelerations is not None
    assert max(model.accelerations) <= 2.5 * 24
    assert len(model.accelerations) == len(model.home)


def mjcf_arm(name, joint):
    """The bodies of an arm; `joint` makes the attributes of a joint from its torque."""
    bodies = ""
    for place, (height, axis, _, _, torque) in enumerate(LINKS, 1):
        bodies += f'<body name="{name}b{place}" pos="0 0 {height}">'
        bodies += f'<joint name="{name}j{place}" axis="{axis}" range="-170 170" {joint(torque)}/>'
        bodies += '<geom type="capsule" size="0.03" fromto="0 0 0 0 0 0.08"/><site/>'
    return f'{bodies}<body name="{name}hand" pos="0 0 0.09"/>{"</body>" * len(LINKS)}'


def test_an_mjcf_file_is_an_arm_with_the_torques_of_its_actuators_and_the_mass_of_its_sheet(arm):
    motors = [f'<motor joint="j{place}" ctrlrange="-{link[-1]} {link[-1]}"/>' for place, link in enumerate(LINKS, 1)]
    base = f'<body name="base"><geom size="0.05"/>{mjcf_arm("", lambda torque: "")}</body>'
    cube = '<body name="cube" pos=".5 0 .02"><freejoint/><geom size=".02"/><body><geom size=".01"/></body></body>'
    target = '<body name="target" mocap="true" pos=".5 0 .2"><geom size=".02" contype="0" conaffinity="0"/></body>'
    write(
        arm.parent, "arm.xml", f"<mujoco><worldbody>{base}</worldbody><actuator>{''.join(motors)}</actuator></mujoco>"
    )
    scene = '<mujoco><include file="arm.xml"/><worldbody>{}<geom type="plane" size="1 1 .1"/></worldbody></mujoco>'
    path = write(arm.parent, "scene.xml", scene.format(cube + target))
    before = spec_in(arm.parent, "{name: urdf, file: scene.xml}").hash()
    robot = robot_of(path, gripper="robotiq_2f85", mass=9.0)
    assert robot.limits.effort == tuple(float(torque) for *_, torque in LINKS)
    assert set(robot.limits.velocity) == {USUAL_SPEED}
    assert robot.model.cut == ("hand_fixed",)
    assert {"cube", "target"}.isdisjoint(robot.model.description.carriers), "objects of a scene are no part of an arm"
    masses = [urdf.inertia_of(link)[0] for link in urdf.read(robot.model.urdf).findall("link")]
    assert sum(masses) == pytest.approx(9.0)
    assert any("MJCF has no speeds" in note for note in proposal_of(robot.settings).notes)
    edit(arm.with_name("arm.xml"), 'size="0.05"', 'size="0.06"')
    assert spec_in(arm.parent, "{name: urdf, file: scene.xml}").hash() != before, "the included file belongs to it"


def test_friction_and_mass_of_an_arm_that_is_heavy_for_its_motors_vary_only_while_it_can_hold_itself(arm):
    for mass, friction, most in ((9.0, 0.5, 2.0), (60.0, 0.3, 1.45)):
        parameters = robot_of(arm, mass=mass).parameters
        assert (parameters["joint_friction"].high, parameters["link_mass"].high) == (friction, most)


def test_one_of_two_arms_in_an_mjcf_file_is_chosen_by_its_tool_and_a_mesh_that_is_only_drawn_is_not_read(arm):
    limit = 'actuatorfrcrange="-{0} {0}"'.format
    drawn = '<geom type="mesh" mesh="mirrored" contype="0" conaffinity="0"/><geom size="0.05"/>'
    arms = [
        f'<body name="{side}" pos="0 {y} 0">{drawn}{mjcf_arm(side, limit)}</body>'
        for side, y in (("left", 0.5), ("right", -0.5))
    ]
    assets = '<asset><mesh name="mirrored" file="base.obj" scale="1 -1 1"/></asset>'
    path = write(arm.parent, "arms.xml", f"<mujoco>{assets}<worldbody>{''.join(arms)}</worldbody></mujoco>")
    with pytest.raises(PluginError, match=r"2 arms begin here, with joints leftj1, rightj1; .*--tool leftb6 or --tool"):
        robot_of(path, gripper="robotiq_2f85", mass=9.0)
    robot = robot_of(path, gripper="robotiq_2f85", mass=9.0, tool="righthand")
    assert robot.limits.effort == tuple(float(torque) for *_, torque in LINKS)
    assert robot.model.cut == ("righthand_fixed",)


@pytest.mark.parametrize(
    ("mesh", "said"),
    [
        ('file="elsewhere/mark.obj"', None),
        ('file="MARK.obj"', "there is no file .*MARK.obj"),
        ('file="mark.msh"', r"it is no file of \.stl, \.obj, \.dae; convert it"),
        ('file="mark.obj" refpos="0 0 1"', "it has refpos or refquat; apply them to its file"),
        ('file="mark.obj" scale="1000 1000 1000"', r'mark\.obj: a part of 10 m; in millimetres\? set scale="0.001'),
        ('file="label.obj"', None),
    ],
)
def test_a_mesh_of_an_mjcf_file_is_found_as_mujoco_finds_it_or_its_defect_has_a_line(arm, mesh, said):
    (arm.parents[1] / "meshes" / "label.obj").write_text("v 0 0 0\nv .1 0 0\nv 0 .1 0\nv .1 .1 0\nf 1 2 4 3\n")
    assets = f'<compiler meshdir="../meshes" strippath="true"/><asset><mesh name="m" inertia="shell" {mesh}/></asset>'
    drawn = '<geom type="mesh" mesh="m" contype="0" conaffinity="0"/>'
    world = f'<worldbody><body name="base">{drawn}{mjcf_arm("", lambda torque: "")}</body></worldbody>'
    path = write(arm.parent, "arm.xml", f"<mujoco>{assets}{world}</mujoco>")
    repair = Repair(path)
    if said is None:
        assert repair.robot is not None
        assert len(repair.robot.findall("link[@name='base']/collision")) == ("label" not in mesh)
    else:
        assert re.search(f"arm.xml:1: mesh m: .*{said}", f"{repair.findings[0].where}: {repair.findings[0].what}")


def test_a_repair_is_a_setting_and_part_of_the_experiment_only_if_it_is_on(arm):
    settings = ("", ", repair: false", ", repair: true")
    plain, off, on = (spec_in(arm.parent, f"{FILE[:-1]}{given}}}").hash() for given in settings)
    assert plain == off != on
    edit(arm, 'effort="60"', 'effort="0"')
    with pytest.raises(PluginError, match=r"^robot.file: .*small.urdf:\d+: joint \w+: .* effort"):
        robot_of(arm)  # and neither the task nor its line
    repaired = robot_of(arm, repair=True)
    assert min(repaired.limits.effort) > 0
    assert any(note.startswith("repaired: its effort is 0") for note in proposal_of(repaired.settings).notes)


def test_an_arm_that_cannot_hold_itself_is_refused_by_the_name_of_its_own_file(arm):
    edit(arm, r'effort="[268]\d"', 'effort="3"')
    with pytest.raises(PluginError, match="cannot hold itself") as refused:
        robot_of(arm, gripper="robotiq_2f85", repair=True)  # which is read from a copy
    assert str(refused.value).startswith(f"robot.file: {arm}: gravity takes joint2")


def test_a_heavy_arm_on_a_spring_feels_no_heavier_than_a_ur10(arm):
    model = robot_of(arm).model
    place = {"home": model.home, "workspace": (model.workspace.low, model.workspace.high)}
    edit(arm, r'effort="[268]\d"', 'effort="9000"')
    ways = []
    for mass in (100.0, 400.0):
        heavy = candidate("robots", "urdf", file=str(arm), mass=mass, control="impedance", **place)
        with reaching(heavy) as environment:
            environment.reset(0)
            start, sideways = environment.robot.tool_position[1], np.eye(6)[1] / 2
            for step in range(30):
                environment.step(sideways * (step < 12))
            ways.append(environment.robot.tool_position[1] - start)
    assert ways[0] > 0.05
    assert ways[1] == pytest.approx(ways[0], rel=0.02)


def test_a_file_of_an_installed_package_is_found_by_the_end_of_its_name(tmp_path, monkeypatch):
    info = tmp_path / "some_arms-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: some-arms\nVersion: 1.0\n")
    (info / "RECORD").write_text("share/arms/urdf/one.urdf,,\nshare/arms/urdf/other_one.urdf,,\n")
    monkeypatch.syspath_prepend(tmp_path)
    spec = spec_in(tmp_path, '{name: urdf, file: "installed:some-arms/urdf/one.urdf"}')
    assert file_of(spec) == str(tmp_path / "share/arms/urdf/one.urdf")
    with pytest.raises(UsageError, match=r"there is no file installed:no-such-arms.*; pip install no-such-arms"):
        robot_of(Path("installed:no-such-arms/one.urdf"))
    with pytest.raises(UsageError, match=r"; some-arms is installed, but has no such file; it has one\.urdf"):
        robot_of(Path("installed:some-arms/onne.urdf"))


@pytest.mark.parametrize(("gap", "apart"), [(0.006, True), (0.004, False), (-0.02, False)])
def test_hulls_are_apart_by_their_true_distance_in_any_direction(gap, apart):
    corners = np.array(list(product((-0.05, 0.05), repeat=3)))
    for turn in np.random.Generator(np.random.PCG64(0)).uniform(-3, 3, size=(20, 3)):
        rotation = urdf.rotation_matrix(*turn)
        turned = corners @ rotation.T
        # its lowest corner is there
        above = turned - turned[turned[:, 2].argmin()] + np.array([0.01, 0.02, 0.05 + gap])
        assert _apart((corners, corners.mean(0)), (above, above.mean(0))) == apart
