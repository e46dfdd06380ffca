"""A small arm of six joints, as a plugin would provide it; its URDF is written on demand.

It works to its left instead of ahead, in a workspace smaller than the square of the tasks, and holds its gripper askew
to the axes of the world: what a task must not take for granted.
"""

import re
from dataclasses import replace
from math import pi
from pathlib import Path

from karolos.robots.arm import Arm, ArmModel, ArmSettings
from karolos.simulation.interface import Box, Fingers, Gripper

ASKEW = 0.3
"""Of the gripper about the vertical at home, in rad."""
WIDTH = 0.07
HOME = (pi / 2, 0.520, 1.566, 0.0, pi - 0.520 - 1.566, pi / 2 + ASKEW)

# height of the joint above the one before (m), axis, length of the link (m), mass (kg), torque (N m)
LINKS = [
    (0.10, "0 0 1", 0.15, 2.0, 80),
    (0.15, "0 1 0", 0.32, 2.0, 80),
    (0.32, "0 1 0", 0.14, 1.2, 60),
    (0.14, "0 0 1", 0.16, 0.8, 20),
    (0.16, "0 1 0", 0.08, 0.4, 20),
    (0.08, "0 0 1", 0.05, 0.3, 20),
]
TOOL = 0.10
"""From the last joint to the point between the pads, in m."""


def _link(name: str, mass: float, shape: str, middle: float) -> str:
    moment = mass * 0.002
    look = f'<origin xyz="0 0 {middle}"/><geometry>{shape}</geometry>'
    return (
        f'<link name="{name}"><inertial><origin xyz="0 0 {middle}"/><mass value="{mass}"/>'
        f'<inertia ixx="{moment}" iyy="{moment}" izz="{moment}" ixy="0" ixz="0" iyz="0"/></inertial>'
        f"<visual>{look}</visual><collision>{look}</collision></link>"
    )


def _joint(name: str, kind: str, ends: tuple[str, str], place: str, axis: str, limit: str) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{ends[0]}"/><child link="{ends[1]}"/>'
        f'<origin xyz="{place}"/><axis xyz="{axis}"/><limit {limit}/></joint>'
    )


def _urdf(*, fingers: bool) -> str:
    parts = [_link("base", 5.0, '<cylinder radius="0.06" length="0.1"/>', 0.05)]
    parent = "base"
    for place, (height, axis, size, mass, torque) in enumerate(LINKS, 1):
        name = f"link{place}"
        length = TOOL + 0.01 if place == len(LINKS) and not fingers else size  # a stick instead of a gripper
        parts.append(_link(name, mass, f'<cylinder radius="0.025" length="{length}"/>', length / 2))
        limit = f'lower="-3.0" upper="3.0" effort="{torque}" velocity="2.5"'
        parts.append(_joint(f"joint{place}", "revolute", (parent, name), f"0 0 {height}", axis, limit))
        parent = name
    for place, side in enumerate((1, -1) if fingers else (), 1):
        parts.append(_link(f"pad{place}", 0.05, '<box size="0.02 0.008 0.03"/>', 0.0))
        limit = f'lower="0" upper="{WIDTH / 2}" effort="15" velocity="0.06"'
        parts.append(
            _joint(
                f"slide{place}", "prismatic", (parent, f"pad{place}"), f"0 {side * 0.004} {TOOL}", f"0 {side} 0", limit
            )
        )
    return f'<robot name="small">{"".join(parts)}</robot>'


def small_arm(folder: Path, *, fingers: bool = True) -> type[Arm]:
    """The plugin class; its URDF is written into `folder`. `fingers`: whether it has a gripper."""
    path = folder / f"small_{fingers}.urdf"
    path.write_text(_urdf(fingers=fingers))

    class Small(Arm):
        """Six joints, reach .7 m."""

        class Settings(ArmSettings):
            """The settings of every arm."""

        model = ArmModel(
            urdf=path,
            home=HOME,
            workspace=Box((-0.2, 0.28, 0.02), (0.2, 0.52, 0.3)),
            tool=(0.0, 0.0, TOOL),
            tool_rpy=(0.0, 0.0, 0.0),
            fingers=Fingers(
                joints=("slide1", "slide2"),
                links=("pad1", "pad2"),
                travel=WIDTH / 2,
                open_at_zero=False,
                gripper=Gripper(width=WIDTH, force=15.0, speed=0.06, pad_friction=1.0),
            )
            if fingers
            else None,
        )

    return Small


OTHER_PROGRAMS = """<link name="tool0"/>
<transmission name="t1"><joint name="joint1"><hardwareInterface>x</hardwareInterface></joint></transmission>
<ros2_control name="c" type="system"><joint name="joint1"/></ros2_control>
<gazebo reference="base"><selfCollide>true</selfCollide></gazebo></robot>"""
"""What exporters write for simulators and controllers."""


def exported_arm(folder: Path) -> type[Arm]:
    """The same arm in a URDF as exporters write it, in a folder of its own with a mesh."""
    small = small_arm(folder)
    package = folder / "small_description"
    (package / "urdf").mkdir(parents=True)
    (package / "meshes").mkdir()
    solid = "v 0 0 0\nv 0 0 .01\nv 0 .01 0\nv .01 0 0\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (package / "meshes" / "mark.obj").write_text(solid)
    text = _urdf(fingers=True)
    mesh = '<visual><geometry><mesh filename="package://small_description/meshes/mark.obj"/></geometry></visual>'
    mimic = '<mimic joint="slide1" multiplier="-1"/><limit lower="-0.035" upper="0"'
    elbow = '<link name="elbow"/>' + _fixed("link2", "elbow", "0 0 0.32")
    for old, new in {
        '<robot name="small">': '<robot name="small"><link name="world"/>' + _fixed("world", "base", "0 0 0"),
        '<link name="base">': f'<link name="base">{mesh}',
        '<link name="link3">': f'{elbow}<link name="link3">',
        '<parent link="link2"/><child link="link3"/><origin xyz="0 0 0.32"/>': (
            '<parent link="elbow"/><child link="link3"/>'
        ),
        '<axis xyz="0 -1 0"/><limit lower="0" upper="0.035"': f'<axis xyz="0 1 0"/>{mimic}',
        'name="joint6" type="revolute"': 'name="joint6" type="continuous"',
        '<origin xyz="0 0 0.08"/><axis xyz="0 0 1"/><limit lower="-3.0" upper="3.0"': (
            '<origin xyz="0 0 0.08"/><axis xyz="0 0 1"/><limit'
        ),
        "</robot>": _fixed("link6", "tool0", f"0 0 {TOOL}") + OTHER_PROGRAMS,
    }.items():
        assert old in text, old
        text = text.replace(old, new)
    path = package / "urdf" / "small.urdf"
    path.write_text(text)

    class Exported(small):  # type: ignore[misc, valid-type]
        """The same arm."""

        model = replace(small.model, urdf=path)

    return Exported


def edit(path: Path, pattern: str, new: str) -> None:
    """Replace every match of a pattern in a file. There has to be one."""
    text, count = re.subn(pattern, new, path.read_text())
    assert count, pattern
    path.write_text(text)


def _fixed(parent: str, child: str, place: str) -> str:
    return (
        f'<joint name="{child}_fixed" type="fixed"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{place}"/></joint>'
    )
