import shutil
import sys
import time
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
from karolos_cli.policy import play
from support.commands import Terminal, karolos, refused
from support.toy_runs import run_of, toy

from karolos import robots
from karolos.errors import MachineError
from karolos.records import RunFolder
from karolos.report.video import with_caption, write_video

SMALL = ("--width", 64, "--height", 48)
SPEC = "name: tiny\nrobot: panda\ntask: {name: reach, max_steps: 6}\nagent: sac\n"


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.yaml"
    path.write_text(SPEC)
    return path


def episodes(told: str) -> dict[int, str]:
    """Number of each episode that was played -> what is said of it, without its measures."""
    lines = (line.split(": ") for line in told.splitlines() if line.startswith("episode"))
    return {int(number.removeprefix("episode ")): said for number, said in lines}


def test_the_expert_of_a_spec_is_filmed_and_its_episodes_are_told(spec, tmp_path):
    film = tmp_path / "film.gif"
    told = karolos("play", spec, "--expert", "--out", film, "--episodes", 2, *SMALL)
    assert told.out == f"{film}\n"
    assert list(episodes(told.err)) == [1, 2]
    assert "after 6 steps" in told.err
    pictures = imageio.imread(film)
    assert pictures.shape[1:3] == (48, 64)
    assert len(pictures) >= 7, "the arm moves"


def test_a_film_that_cannot_be_written_is_refused_before_anything_is_played(spec):
    for film in ("/sys/film.mp4", "/sys/film.gif"):  # even root may not make a file there
        with pytest.raises(MachineError, match=f"{film}: cannot be written"):
            write_video(Path(film), iter(lambda: pytest.fail("a picture was made"), None), 24)
        assert refused("play", spec, "--expert", "--out", film, code=3).count("\n") == 1


def test_a_film_has_one_episode_by_default_and_a_bar(spec, tmp_path, monkeypatch):
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("TERM", "xterm")
    play(str(spec), expert=True, out=tmp_path / "film.mp4", width=64, height=48)
    assert "recording" in screen.getvalue()
    assert "episode 1: " in screen.getvalue()
    assert "episode 2" not in screen.getvalue()
    film = imageio.immeta(tmp_path / "film.mp4")
    assert film["fps"] == 24
    assert film["duration"] == pytest.approx((7 + 17) / 24, abs=0.1), "the outcome stands for .7 s"


def test_pictures_of_a_film_say_how_an_episode_goes():
    plain = np.full((240, 320, 3), 200, np.uint8)
    running = with_caption(plain, "episode 1", success=False, failed=False)
    assert (running[:40] != plain[:40]).any()
    assert (running[60:] == plain[60:]).all()
    for success, strongest in ((True, 1), (False, 0)):
        assert with_caption(plain, "", success=success, failed=True)[0, 0].argmax() == strongest


def test_small_objects_keep_their_colour_in_a_gif(tmp_path):
    pictures = [np.tile(np.arange(k, k + 240, dtype=np.uint8)[:, None, None], (1, 240, 3)) for k in range(16)]
    for place, picture in enumerate(pictures):
        picture[place : place + 4, :4] = (220, 30, 30)
    write_video(tmp_path / "film.gif", pictures, 12)
    for place, picture in enumerate(imageio.imread(tmp_path / "film.gif")):
        assert np.abs(picture[place + 1, 1, :3].astype(int) - (220, 30, 30)).max() < 20


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--expert", "--width", 65, "--out", "film.gif"], "cannot be encoded"),
        (["--expert", "--out", "film.txt"], "cannot record"),
    ],
)
def test_what_cannot_be_filmed_is_refused(spec, arguments, message):
    assert message in refused("play", spec, *arguments)


def test_a_window_shows_the_episodes_at_the_pace_of_control(spec, monkeypatch):
    """PyBullet connects without a window here, and tells what the window would show. MuJoCo has none: a film."""
    pybullet = pytest.importorskip("pybullet")
    connect, opened, cameras, pauses = pybullet.connect, [], [], []
    monkeypatch.setattr(pybullet, "connect", lambda mode: opened.append(mode) or connect(pybullet.DIRECT))
    monkeypatch.setattr(pybullet, "resetDebugVisualizerCamera", lambda *place, **_: cameras.append(place))
    monkeypatch.setattr(time, "sleep", pauses.append)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.chdir(spec.parent)
    told = karolos("play", spec, "environment.engine=bullet", "--expert", "--episodes", 2)
    assert told.out == ""
    assert opened == [pybullet.GUI]
    assert len(cameras) == 1
    assert pauses == [pytest.approx(1 / 24)] * 2 * 7
    assert list(episodes(told.err)) == [1, 2]
    assert [path.name for path in spec.parent.iterdir()] == [spec.name], "no film is written"
    told = karolos("play", spec, "--expert", *SMALL)
    assert told.out == "tiny.mp4\n"
    assert "no window" in told.err.splitlines()[0]


TOY = toy(environment={"name": "toy", "max_steps": 7}, training={"steps": 40, "replay_ratio": 2})


def test_a_run_is_filmed_for_tensorboard_too_and_without_a_best_checkpoint_its_last(tmp_path):
    folder = run_of(TOY, tmp_path / "runs").path
    film = ("--out", tmp_path / "film.gif", "--episodes", 1, *SMALL)
    assert list(episodes(karolos("play", folder, *film).err)) == [1]
    assert not (folder / "tensorboard" / "film").exists()
    assert karolos("play", folder, *film[2:]).out == f"{folder / 'play.mp4'}\n"
    [events] = (folder / "tensorboard" / "film").iterdir()
    assert b"GIF89a" in events.read_bytes()
    shutil.rmtree(folder / "checkpoints" / "best")  # as in a run that was stopped before its first test
    told = karolos("play", folder, *film).err.splitlines()[0]
    assert told == f"{folder.name} was never tested and has no checkpoint best: using last"
    shutil.rmtree(folder / "checkpoints" / "last")
    shutil.rmtree(folder / "checkpoints" / "previous", ignore_errors=True)
    assert "there is no checkpoint 'best'" in refused("play", folder, *film, code=1)


def test_modules_that_a_run_names_are_told_before_they_are_imported(tmp_path):
    with RunFolder.create(tmp_path, "evil", 0) as folder:
        folder.describe({"environment": {"name": "gymnasium", "id": "somebodys.module:X-v0"}}, experiment="x")
    said = refused("play", folder.path, "--out", tmp_path / "film.gif")
    assert said.startswith(f"{folder.id} names code of this machine: somebodys.module will be imported\n")


FILM = (*SMALL, "--out", "film.gif")


def test_a_policy_is_played_under_changed_settings(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    plain, ur5, short = (
        karolos("play", "panda_reach", *changed, *FILM).err
        for changed in ([], ["robot=ur5"], ["task.max_steps=3", "task.gravity=0"])
    )
    assert plain.startswith("episode 1: success")
    assert ur5.startswith("episode 1: success after")
    assert ur5 != plain
    assert "after 3 steps" in short
    for wrong, told in (
        ("agent.discount=0.9", "changes the training, not the test"),
        ("robot.control=joint", "the policy was trained with other observations, actions or goals"),
    ):
        assert told in refused("play", "panda_reach", wrong, *FILM)
    ur5_file = Path(robots.__file__).with_name("urdf") / "ur5.urdf"
    own = ["robot.name=urdf", f"robot.file={ur5_file}", "robot.gripper=null"]
    assert "robot.gripper: this robot has no gripper; mount one" in refused("play", "panda_pick", *own, *FILM)
    assert refused("play", "panda_reach", "task=insert", *FILM).startswith("override task=insert: robot.control: ")


def test_failures_alone_are_played_and_called_by_their_numbers(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    short = ("panda_reach", "task.max_steps=8", *FILM)  # too few steps for the furthest goals
    failed = episodes(karolos("play", *short, "--failures", "--episodes", 3).err)
    assert [said.split(" after")[0] for said in failed.values()] == ["no success"] * 3
    assert sorted(failed) == list(failed)
    every = episodes(karolos("play", *short, "--episodes", max(failed)).err)
    assert [number for number, said in every.items() if not said.startswith("success")] == list(failed)
