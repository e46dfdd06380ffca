"""A URDF with several mistakes: all are found at once, and the copy in which they are repaired is an arm."""

from pathlib import Path

import pytest
from support.fourth_robot import edit

from karolos.robots.proposal import propose
from karolos.robots.repair import Repair
from karolos.simulation import urdf

MISTAKES = {
    'effort="60"': 'effort="0" drake:acceleration="2"',
    '<mass value="1.2"/>': '<mass value="0"/>',
    'ixx="0.0008" iyy="0.0008" izz="0.0008"': 'ixx="0" iyy="0" izz="0"',
    "small_description/meshes": "elsewhere",
    'effort="20" velocity="2.5"': 'effort="20" velocity="0"',
}


def mass_of(path: Path) -> float:
    return sum(urdf.inertia_of(link)[0] for link in urdf.read(path).findall("link"))


def test_all_mistakes_are_found_at_once_and_repaired(arm, tmp_path):
    for old, new in MISTAKES.items():
        edit(arm, old, new)
    repair = Repair(arm, mass=12.0)
    found = [f"{finding.where.rpartition(': ')[2]}: {finding.what}" for finding in repair.findings]
    assert found[1:] == [
        "link base: there is no mesh 'package://elsewhere/mark.obj'",
        "link link3: it moves and has no mass",
        "link link5: its inertia is not positive definite",
        "joint joint3: its effort is 0",
        "joint joint4: its velocity is 0",
        "joint joint5: its velocity is 0",
        "joint joint6: its velocity is 0",
    ]
    assert "the prefix drake is not declared" in found[0]
    assert all(finding.change for finding in repair.findings)
    repair.write(copy := tmp_path / "copy.urdf")
    assert mass_of(copy) == pytest.approx(12.0, rel=0.02)
    assert not Repair(copy).findings
    propose(copy)


def test_a_mesh_is_found_by_its_name_in_another_folder_or_case_and_on_no_whole_disk(arm, monkeypatch):
    edit(arm, "small_description/meshes/mark.obj", "elsewhere/MARK.obj")
    [found] = Repair(arm).findings
    assert found.change.endswith("small_description/meshes/mark.obj, which has its name")
    monkeypatch.setattr("karolos.robots.repair.MOST_FILES", 1)
    assert Repair(arm).findings[0].change == "it is not drawn"


def test_a_mesh_of_a_link_without_collision_shapes_cannot_be_left_out(arm):
    edit(arm, "<collision>.*?</collision>", "")
    edit(arm, "small_description/meshes", "elsewhere")
    (arm.parent.parent / "meshes" / "mark.obj").unlink()
    assert Repair(arm).findings[0].change == ""


def test_a_mesh_that_marks_a_frame_can_be_left_out(arm):
    mark = '<link name="mark"><visual><geometry><mesh filename="none.obj"/></geometry></visual></link>'
    fixed = '<joint name="mark" type="fixed"><parent link="link6"/><child link="mark"/></joint>'
    edit(arm, "<collision>.*?</collision>", "")
    edit(arm, "</robot>", f"{mark}{fixed}</robot>")
    assert [one.change for one in Repair(arm).findings if "none.obj" in one.what] == ["it is not drawn"]


def test_a_urdf_that_has_the_suffix_of_mjcf_gets_another_name(arm):
    [found] = Repair(arm.rename(arm.with_suffix(".xml"))).findings
    assert found.what == "not an MJCF file; a URDF is called small.urdf"


def test_a_sound_file_has_no_findings_and_is_scaled_to_its_mass(arm, tmp_path):
    assert not Repair(arm).findings
    edit(arm, 'lower="-0.035" upper="0" effort="15"', 'effort="0"')  # a finger that mimics the other needs no limits
    assert not Repair(arm).findings
    repair = Repair(arm, mass=20.0)
    [finding] = repair.findings
    assert finding.what.endswith("the data sheet says 20")
    repair.write(tmp_path / "copy.urdf")
    assert mass_of(tmp_path / "copy.urdf") == pytest.approx(20.0)


def test_a_repaired_inertia_keeps_the_mass_of_what_is_fixed_to_its_link(arm, tmp_path):
    edit(arm, 'ixx="0.0008" iyy="0.0008" izz="0.0008"', 'ixx="0" iyy="0" izz="0"')
    tool = '<joint name="hold" type="fixed"><parent link="link5"/><child link="tool"/></joint>'
    edit(arm, "</robot>", f'<link name="tool"><inertial><mass value="0.5"/></inertial></link>{tool}</robot>')
    repair = Repair(arm)
    assert "link5: its inertia is not positive definite" in f"{repair.findings[0].where}: {repair.findings[0].what}"
    before = mass_of(arm)
    repair.write(tmp_path / "copy.urdf")
    assert mass_of(tmp_path / "copy.urdf") == pytest.approx(before)


def test_a_repaired_motor_moves_its_dry_friction_too_and_other_attributes_of_a_mass_stay(arm, tmp_path):
    edit(arm, 'effort="60"', 'effort="30"')
    edit(arm, '<limit ([^>]*effort="30")', r'<dynamics friction="400"/><limit \1')
    edit(arm, '<mass value="1.2"/>', '<mass value="1.2" unit="kg"/>')
    repair = Repair(arm, mass=20.0)
    assert "its effort is 30, of which friction takes 400" in {finding.what for finding in repair.findings}
    repair.write(tmp_path / "copy.urdf")
    assert not Repair(tmp_path / "copy.urdf").findings
    assert mass_of(tmp_path / "copy.urdf") == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("</robot>", "", "not an XML file"),
        ('"0 0 0.32"', '"0 0 x"', "its xyz is '0 0 x'"),
        ("small_description/meshes/mark.obj", "none.obj", "there is no mesh"),
    ],
)
def test_what_nobody_can_know_is_found_without_a_change(arm, old, new, what):
    text = arm.read_text().replace("visual", "collision", 4)
    arm.write_text(text.replace(old, new))
    findings = Repair(arm).findings
    assert what in findings[-1].what
    assert not findings[-1].change


def declare_macros(path: Path, more: str = "") -> None:
    """Declare the prefix of xacro in a URDF, with more elements at its beginning."""
    edit(path, "<robot([^>]*)>", rf'<robot xmlns:xacro="http://www.ros.org/wiki/xacro"\1>{more}')


def test_macros_are_expanded_where_a_person_asks_for_it(arm):
    pytest.importorskip("xacro")
    edit(arm, 'velocity="2.5"', 'velocity="${speed}"')
    here = '<xacro:property name="here" value="$(find urdf)"/>'
    declare_macros(arm, f'<xacro:property name="speed" value="${{1.25 * 2}}"/>{here}')
    refused = Repair(arm)
    assert refused.robot is None
    assert "macros of xacro" in refused.findings[0].what
    found = Repair(arm, expand=True)
    assert [one.what for one in found.findings][:1] == ["macros of xacro"]
    assert found.robot is not None
    assert {limit.get("velocity") for limit in found.robot.iter("limit")} >= {"2.5"}


def test_macros_that_use_themselves_are_refused_in_one_line(arm):
    pytest.importorskip("xacro")
    declare_macros(arm, f'<xacro:include filename="{arm.name}"/>')
    found = Repair(arm, expand=True)
    assert found.robot is None
    assert found.findings[0].what.startswith("xacro cannot expand it: it uses itself; xacro:include or a macro")


def test_a_file_that_only_declares_the_prefix_of_macros_needs_none(arm):
    declare_macros(arm)
    assert not Repair(arm, expand=True).findings
