import numpy as np
import pytest
from PIL import Image
from support.commands import karolos, refused, rows
from support.robots import ROBOTS

SMALL = ("--width", "32", "--height", "24")


@pytest.mark.parametrize("name", ROBOTS)
def test_robot_is_shown_with_a_picture(name, tmp_path):
    target = tmp_path / "robot.png"
    [found] = rows("inspect", "robot", name, "--out", target, *SMALL)
    assert found["joints"]
    actions = {f"action ({mode})" for mode in ("joint", "cartesian", "pose", "impedance")}
    assert {*actions, "parameters", "settings", "tool", "flange", "gripper"} <= set(found)
    (steps, *_), speeds = found["action (joint)"], [row["speed_rad_s"] for row in found["joints"]]
    told = [float(word) for word in steps["an action of 1, in 1/24 s"].split()[: len(speeds)]]
    assert told == pytest.approx([min(0.5, speed / 24) for speed in speeds], abs=1e-3)
    assert Image.open(target).size == (32, 24)


def test_robot_is_shown_without_a_goal(tmp_path):
    def green(kind: str, name: str) -> int:
        target = tmp_path / f"{name}.png"
        karolos("inspect", kind, name, "--out", target, "--width", 160, "--height", 120)
        red, green, blue = np.asarray(Image.open(target), int).transpose(2, 0, 1)
        return int(((green > red + 30) & (green > blue + 30)).sum())

    assert green("task", "reach") > 20
    assert green("robot", "panda") == 0


@pytest.mark.parametrize("name", ["reach", "insert", "throw"])  # tests/environments draws all
def test_task_is_shown_with_a_picture(name, tmp_path):
    target = tmp_path / "task.png"
    assert "task.gravity" in karolos("inspect", "task", name, "--out", target, *SMALL).out
    assert target.exists()


@pytest.mark.parametrize("words", ["robot pandda", "task reach --out x.txt", "task reach --out none/x.png"])
def test_unknown_names_and_bad_files_are_refused(words):
    assert refused("inspect", *words.split())
