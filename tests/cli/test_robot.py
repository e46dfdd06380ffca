"""`karolos robot`: an arm's file is checked, and scored with policies that never saw it."""

import json
from pathlib import Path

import pytest
from support.commands import karolos, refused, rows
from support.fourth_robot import exported_arm
from support.processes import Here

from karolos.plans import robot_score
from karolos.plugins import robot_check
from karolos.plugins.contracts import cases
from karolos.records.shipped import FOLDER, shipped_names


@pytest.fixture
def arm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, quick_proposals: None) -> Path:
    monkeypatch.chdir(tmp_path)
    return exported_arm(tmp_path).model.urdf


def test_a_check_tells_everything_at_once_and_goes_on_with_the_repaired_copy(arm, tmp_path, monkeypatch):
    monkeypatch.setattr(robot_check, "cases", lambda *one, **how: cases(*one, **how)[:3])  # all take a minute
    arm.write_text(arm.read_text().replace('effort="60"', 'effort="0"').replace("/meshes/", "/elsewhere/"))
    options = "--repair copy.urdf --no-promises --out arm.png --gripper robotiq_2f85"
    lines = karolos("robot", "check", arm, *options.split(), code=3).out.splitlines()
    assert sum(line.startswith("wrong: ") and "; repaired: " in line for line in lines) == 2
    assert "assumed: arm: joint1, joint2, joint3, joint4, joint5, joint6" in lines
    assert (tmp_path / "arm.png").stat().st_size > 1000
    found = rows("robot", "check", "copy.urdf")
    assert {row["kind"] for row in found} >= {"assumed", "promise"}
    assert [row["problem"] for row in found if row["kind"] == "promise" and not row["kept"]] == []
    told = karolos("robot", "check", "installed:arms/one.urdf", code=3).out
    assert "read (No such file or directory); pip install arms" in told


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("check", "--gripper", "nope"), "no gripper is called 'nope'; installed grippers: franka_hand"),
        (("score", "--gripper", "nope"), "no gripper is called 'nope'; installed grippers: franka_hand"),
        (("check", "--repair", "arm.xml"), "--repair: the copy cannot be arm.xml; it is a URDF of its own"),
        (("check", "--mass", "inf"), "--mass"),
    ],
)
def test_an_option_that_cannot_be_meant_is_refused(arm, arguments, said):
    command, *options = arguments
    assert said in refused("robot", command, arm, *options)


def test_the_copy_of_a_repair_never_replaces_the_file(arm):
    before = arm.read_text()
    refused("robot", "check", arm, "--repair", arm)
    assert arm.read_text() == before


def test_a_score_names_success_and_causes_and_writes_a_page(arm, tmp_path):
    [row] = rows("robot", "score", arm, "--policies", "ur5_reach", "--episodes", 2)
    assert (row["task"], row["episodes"], row["refused"]) == ("reach", 2, None)
    assert sum(row["causes"].values()) == 2 - 2 * row["success"]
    assert set(row["causes"]) <= set(robot_score.CAUSES)
    folder = tmp_path / "small-score"
    assert (folder / "ur5_reach.mp4").stat().st_size > 1000
    assert "Assumptions about the file" in (folder / "score.html").read_text()
    assert json.loads((folder / "score.json").read_text())["policies"] == [row]
    [kept] = rows("robot", "score", "small", "--list")
    assert (kept["policy"], kept["robot"], kept["gripper"]) == ("ur5_reach", "small", "robotiq_2f85")
    assert (kept["success_end"], kept["causes"], kept["own"]["episodes"]) == (row["success"], row["causes"], 2)
    assert "small" in karolos("robot", "score", "--list").out
    told = karolos("robot", "score", "panda", "--list")
    assert "small" not in told.out
    assert "there are no scores in runs" in told.err
    refused("robot", "score")


def test_a_task_that_the_robot_cannot_do_is_named_with_the_reason(arm):
    text = arm.read_text().replace('"prismatic"', '"revolute"')
    arm.write_text(text)
    found = robot_score.score_policy(FOLDER / "ur5_pick", ["robot.name=urdf", f"robot.file={arm}"], 1)
    assert found.success is None
    assert found.refused is not None
    assert "this robot has no gripper; mount one (robot.gripper=robotiq_2f85), or choose" in found.refused


def test_policies_are_those_of_a_robot_or_one(arm):
    assert robot_score.policies_of("iiwa") == [FOLDER / name for name in shipped_names() if name.startswith("iiwa_")]
    assert "did you mean 'ur5'" in refused("robot", "score", arm, "--policies", "ur6")


def test_several_robots_have_a_table_in_which_the_arm_counts_and_who_is_refused_is_named(arm, tmp_path, monkeypatch):
    monkeypatch.setattr(robot_score, "playing_processes", Here)
    broken = arm.with_name("broken.urdf")
    broken.write_text(arm.read_text().replace('effort="60"', 'effort="0"'))
    (tmp_path / "none.urdf").write_text("<robot/>")
    robots = (broken, "panda", "none.urdf")
    out = karolos("robot", "score", *robots, "--policies", "ur5_reach", "--episodes", 2).out
    row = next(line for line in out.split("Over arms")[-1].splitlines() if line.startswith("reach"))
    assert row.split()[1] == "2"
    assert "none.urdf: not a URDF" in row
    kept = json.loads((tmp_path / "broken-score" / "score.json").read_text())
    assert any(note.startswith("repaired: its effort is 0") for note in kept["assumed"])
