"""`karolos plugins new robot --urdf`: what is proposed for somebody's URDF; tests/docs goes the way of the guide."""

import importlib
import re
from dataclasses import replace
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
from support.commands import refused
from support.fourth_robot import TOOL, WIDTH, exported_arm

from karolos.errors import PluginError, UsageError
from karolos.plugins.starter import write_starter
from karolos.robots import poses
from karolos.robots.arm import Arm, ArmSettings
from karolos.robots.proposal import Known, Proposal, doubts, propose, with_meshes
from karolos.simulation import urdf


@pytest.fixture
def path(tmp_path: Path, quick_proposals: None) -> Path:
    return exported_arm(tmp_path).model.urdf


def test_arm_tool_gripper_home_and_workspace_are_found_in_a_urdf_as_exporters_write_it(tmp_path):
    found = propose(exported_arm(tmp_path).model.urdf)
    model, fingers = found.model, found.model.fingers
    assert found.notes[1] == "arm: joint1, joint2, joint3, joint4, joint5, joint6"
    assert model.tool == (0.0, 0.0, TOOL)  # the frame tool0
    assert fingers is not None
    assert fingers.joints == ("slide1", "slide2")
    assert (fingers.travel, fingers.open_at_zero, fingers.gripper.width) == (WIDTH / 2, False, WIDTH)
    assert model.locked == {}
    assert min(np.subtract(model.workspace.high, model.workspace.low)) > 0.2
    assert model.workspace.low[2] < 0.03, "the tool reaches objects on the floor"
    assert [note.partition(":")[0] for note in found.notes] == [
        "base", "arm", "gripper", "tool", "home", "workspace", "dexterous", "self-collisions",
    ]  # fmt: skip


def test_the_tool_is_at_the_tips_of_the_fingers_where_no_frame_names_it(path):
    path.write_text(path.read_text().replace("tool0", "somewhere"))
    assert propose(path).model.tool == pytest.approx((0, 0, TOOL + 0.015 - 0.01), abs=1e-6)


def test_a_tool_frame_whose_z_points_back_into_the_arm_is_turned_towards_the_fingers(path):
    text, place = path.read_text(), f'<child link="tool0"/><origin xyz="0 0 {TOOL}"'
    assert place in text
    path.write_text(text.replace(place, f'{place} rpy="3.14159265 0 0"'))
    found = propose(path)
    assert found.model.tool == (0, 0, TOOL)
    assert any(note.startswith("tool: the frame tool0") and "along 0.000 0.000 1.000" in note for note in found.notes)


def test_limits_in_another_unit_are_named_where_the_tool_reaches_nothing(path):
    path.write_text(path.read_text().replace('lower="-3.0" upper="3.0"', 'lower="-0.05" upper="0.05"'))
    with pytest.raises(
        PluginError, match=r"pointing down; joint1, .*, joint5 turn by less than 0.2 rad; a URDF has rad"
    ):
        propose(path)


def test_a_gripper_with_turning_fingers_is_locked(path):
    path.write_text(path.read_text().replace('"prismatic"', '"revolute"'))
    found = propose(path)
    assert found.model.fingers is None
    assert found.model.locked == {"slide1": 0.0}
    assert "locked, they do not move: slide1, slide2" in found.notes


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('type="revolute"', 'type="prismatic"', "the arm has only 1 turning joint (joint6)"),
        ("small_description/meshes", "elsewhere", "link base: there is no mesh 'package://elsewhere/mark.obj'"),
        ('"joint3"', '"j&#10;import os"', r"<joint>: its name is 'j\nimport os'; 1 to 100"),
        ('"link3"', '"l&#x202e;"', r"<link>: its name is 'l\u202e'"),
    ],
)
def test_a_urdf_that_does_not_work_is_refused_in_one_line_and_nothing_is_written(path, tmp_path, old, new, message):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    err = refused("plugins", "new", "robot", "mine", "--urdf", path, "--out", tmp_path / "new", code=3)
    assert message in err
    assert len(err.strip().splitlines()) <= 2, "the message and a hint"
    assert not (tmp_path / "new").exists()


HOSTILE = (r"C:\new\u", '"""+1/0+"""', "it's", "#{x}", "$$name")
"""Names that are not what they seem in Python source, its docstrings and comments, or in a template."""


def test_names_become_literals_in_the_module(path, tmp_path, monkeypatch):
    text = path.read_text()
    for old, new in zip(("joint1", "slide1", "pad1", "link6", "elbow"), HOSTILE, strict=True):
        text = text.replace(f'"{old}"', quoteattr(new))
    (hostile := path.with_name('"""; 1 if.urdf')).write_text(text)
    found: list[Proposal] = []
    monkeypatch.setattr("karolos.robots.proposal.propose", lambda *what: found.append(propose(*what)) or found[-1])
    _, notes = write_starter("robot", "mine", tmp_path / "mine", urdf=hostile)
    monkeypatch.syspath_prepend(tmp_path / "mine" / "src")
    module = importlib.import_module("karolos_mine.mine")
    assert notes == module.ASSUMED
    assert HOSTILE[0] in module.ASSUMED[1]
    assert module.Mine.model == replace(found[0].model, urdf=module.Mine.model.urdf)
    assert module.Mine.model.fingers.joints[0] == HOSTILE[1]
    module.Mine(module.Mine.Settings())  # the model fits the URDF in the package


def test_a_package_takes_the_meshes_alone_and_no_file_that_they_name(path, tmp_path):
    mark = path.parent.parent / "meshes" / "mark.obj"
    mark.with_suffix(".mtl").write_text("map_Kd /etc/passwd\n")
    mark.write_text("mtllib mark.mtl\nmtllib /dev/zero\nmtllib ../../secret.mtl\n" + mark.read_text())
    text, copies = with_meshes(path)
    assert copies == {"meshes/0_mark.obj": mark}
    assert 'filename="meshes/0_mark.obj"' in text
    mark.rename(secret := tmp_path / "secret")
    mark.symlink_to(secret)
    with pytest.raises(PluginError, match=r"urdf:1: link base: cannot read the mesh 'package://"):
        write_starter("robot", "mine", tmp_path / "mine", urdf=path)


def test_a_hand_whose_fingers_have_many_joints_is_no_second_arm(path):
    ends = [(f"{name}{place}", f"{name}{place - 1}" if place else "link6") for name in "ab" for place in range(3)]
    fingers = [
        f'<link name="{link}"><inertial><mass value="0.1"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>'
        f'<joint name="to_{link}" type="revolute"><parent link="{above}"/><child link="{link}"/><axis xyz="0 1 0"/>'
        '<limit lower="0" upper="1" effort="1" velocity="1"/></joint>'
        for link, above in ends
    ]
    path.write_text(path.read_text().replace("</robot>", f"{''.join(fingers)}</robot>"))
    assert f"arm: {', '.join(f'joint{place}' for place in range(1, 7))}" in propose(path, "robotiq_2f85").notes


def test_of_two_arms_one_is_chosen_by_its_tool(path):
    whole = path.read_text()
    first = whole.index('<link name="link1">')
    second = re.sub(r'"(link|joint|pad|slide|elbow|tool0)', r'"left_\1', whole[first : whole.index("<transmission")])
    path.write_text(whole.replace("<transmission", f"{second}<transmission", 1))
    with pytest.raises(PluginError, match=r"link world: 2 arms begin here, with joints joint1, left_joint1; .*--tool"):
        propose(path)
    found = propose(path, known=Known("left_tool0"))
    assert found.notes[1].startswith("arm: left_joint1, ")
    assert found.model.tool == (0, 0, TOOL)
    with pytest.raises(UsageError, match="there is no link 'tool7'; links: world, base"):
        propose(path, known=Known("tool7"))


def test_home_lies_in_the_workspace_below_a_ceiling_too(path, monkeypatch):
    monkeypatch.setattr(poses, "HEIGHTS", (1.0,))
    monkeypatch.setattr(poses, "ENOUGH", 0.85)  # nowhere is room enough, so that all others are looked at
    upright = '<child link="base"/><origin xyz="0 0 0"/>'
    text = path.read_text()
    assert upright in text
    path.write_text(text.replace(upright, '<child link="base"/><origin xyz="0 0 1" rpy="3.14159265 0 0"/>'))
    model = propose(path).model
    type("Mine", (Arm,), {"model": model, "Settings": ArmSettings})(ArmSettings())  # refuses a home outside


def test_an_arm_works_in_front_of_its_base_wherever_that_stands_in_the_world(path):
    here, text = propose(path), path.read_text()
    upright = '<child link="base"/><origin xyz="0 0 0"/>'
    assert upright in text
    path.write_text(text.replace(upright, '<child link="base"/><origin xyz="-0.5 2 0"/>'))
    there = propose(path)
    for end in ("low", "high"):
        moved = np.add(getattr(here.model.workspace, end), (-0.5, 2, 0))
        assert getattr(there.model.workspace, end) == pytest.approx(moved, abs=2e-3)
    assert there.notes[0].endswith("on the floor z = 0")
    path.write_text(text.replace(upright, '<child link="base"/><origin xyz="0 0 20"/>'))
    assert doubts(urdf.load(path, strict=False)) == [], "a pedestal does not make the arm longer"


def test_numbers_that_are_hardly_meant_and_tool_frames_that_were_not_taken_are_named(path):
    text = path.read_text()
    for old, new in {
        'lower="-3.0" upper="3.0" effort="60" velocity="2.5"': 'lower="-166" upper="166" effort="60" velocity="10"',
        'lower="-3.0" upper="3.0" effort="80"': 'lower="-1e16" upper="1e16" effort="1e300"',  # no limit, no doubt
        'ixx="0.0024" iyy="0.0024" izz="0.0024"': 'ixx="1e4" iyy="1e4" izz="1e4"',
        '<mass value="0.4"/>': '<mass value="800"/>',
        "</robot>": '<link name="flange"/><joint name="f" type="fixed"><parent link="link6"/>'
        '<child link="flange"/></joint></robot>',
    }.items():
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)
    notes = propose(path).notes
    assert [note for note in notes if note.startswith("doubted: ")][:4] == [
        "doubted: joint joint3: to 166 rad; are these degrees?",
        "doubted: joint joint3: at 10 rad/s; compare the data sheet",
        "doubted: link link3: moments from 1e+04 to 1e+04 kg m2 at 1.2 kg; compare the CAD",
        "doubted: link link5: 800 kg; are these grams?",
    ]
    path.write_text(re.sub(r"(?s)<(collision|visual)>.*?</\1>", "", text))
    assert "the arm: without shapes, so it collides with nothing" in doubts(urdf.load(path, strict=False))
    assert "; not flange, which --tool LINK chooses" in next(note for note in notes if "the frame tool0" in note)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(("task", "x", "--urdf", "x"), "a task has no URDF"), (("robot", "x", "--tool", "x"), "add --urdf FILE")],
)
def test_options_that_do_not_go_together_are_refused(arguments, message):
    assert message in refused("plugins", "new", *arguments)
