import shutil
import sys
import time
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
from karolos_cli.policy import play
from support.commands import Terminal, call
from support.toy_runs import toy
from typer import Typer

from karolos.errors import MachineError
from karolos.launchers.experiment import Experiment
from karolos.records import RunFolder
from karolos.report.video import with_caption, write_video

app = Typer()
app.command()(play)
SPEC = "name: tiny\nrobot: panda\ntask: {name: reach, max_steps: 6}\nagent: sac\n"


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.yaml"
    path.write_text(SPEC)
    return path


def episodes(told: str) -> list[str]:
    """The lines of episodes, without those of their measures."""
    return [line for line in told.splitlines() if line.startswith("episode")]


def test_the_expert_of_a_spec_is_filmed_and_its_episodes_are_told(spec, tmp_path):
    film = tmp_path / "film.gif"
    size = ("--width", "64", "--height", "48")
    code, out, err = call(app, str(spec), "--expert", "--out", str(film), "--episodes", "2", *size)
    assert code == 0, err
    assert out.strip() == str(film)
    assert [line.split(":")[0] for line in episodes(err)] == ["episode 1", "episode 2"]
    assert "after 6 steps" in err
    pictures = imageio.imread(film)
    assert pictures.shape[1:3] == (48, 64)
    assert len(pictures) >= 7, "the arm moves"


def test_a_film_that_cannot_be_written_is_refused_before_anything_is_played(spec):
    for film in ("/sys/film.mp4", "/sys/film.gif"):  # even root may not make a file there
        with pytest.raises(MachineError, match=f"{film}: cannot be written"):
            write_video(Path(film), iter(lambda: pytest.fail("a picture was made"), None), 24)
        code, _, err = call(app, str(spec), "--expert", "--out", film)
        assert (code, err.count("\n")) == (3, 1)


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
        (("--width", "65"), "cannot be encoded"),
        (("--out", "film.txt"), "cannot record"),
        (("--checkpoint", "worst"), "'worst'"),
    ],
)
def test_what_cannot_be_filmed_is_refused(spec, arguments, message):
    defaults = () if "--out" in arguments else ("--out", str(spec.with_suffix(".gif")))
    code, _, err = call(app, str(spec), "--expert", *defaults, *arguments)
    assert code == 2
    assert message in err


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
    code, out, err = call(app, str(spec), "environment.engine=bullet", "--expert", "--episodes", "2")
    assert (code, out) == (0, ""), err
    assert opened == [pybullet.GUI]
    assert len(cameras) == 1
    assert pauses == [pytest.approx(1 / 24)] * 2 * 7
    assert [line.split(":")[0] for line in episodes(err)] == ["episode 1", "episode 2"]
    assert [path.name for path in spec.parent.iterdir()] == [spec.name], "no film is written"
    code, out, err = call(app, str(spec), "--expert", "--width", "64", "--height", "48")
    assert (code, out) == (0, "tiny.mp4\n"), err
    assert "no window" in err.splitlines()[0]


TOY = toy(environment={"name": "toy", "max_steps": 7}, training={"steps": 40, "replay_ratio": 2})


def test_a_run_is_filmed_for_tensorboard_too_and_without_a_best_checkpoint_its_last(tmp_path):
    folder = Path(Experiment(TOY).run(tmp_path / "runs").runs[0].folder)
    film = ("--out", str(tmp_path / "film.gif"), "--episodes", "1", "--width", "64", "--height", "48")
    code, _, err = call(app, str(folder), *film)
    assert (code, [line.split(":")[0] for line in episodes(err)]) == (0, ["episode 1"])
    assert not (folder / "tensorboard" / "film").exists()
    code, out, err = call(app, str(folder), *film[2:])
    assert (code, out) == (0, f"{folder / 'play.mp4'}\n"), err
    [events] = (folder / "tensorboard" / "film").iterdir()
    assert b"GIF89a" in events.read_bytes()
    shutil.rmtree(folder / "checkpoints" / "best")  # as in a run that was stopped before its first test
    code, _, err = call(app, str(folder), *film)
    assert code == 0, err
    assert err.splitlines()[0] == f"{folder.name} was never tested and has no checkpoint best: using last"
    code, _, err = call(app, str(folder), *film, "--checkpoint", "best")
    assert code == 1
    assert "there is no checkpoint 'best'" in err
    shutil.rmtree(folder / "checkpoints" / "last")
    shutil.rmtree(folder / "checkpoints" / "previous", ignore_errors=True)
    code, _, err = call(app, str(folder), *film)
    assert code == 1
    assert "there is no checkpoint 'best'" in err


def test_modules_that_a_run_names_are_told_before_they_are_imported(tmp_path):
    with RunFolder.create(tmp_path, "evil", 0) as folder:
        folder.describe({"environment": {"name": "gymnasium", "id": "somebodys.module:X-v0"}}, experiment="x")
    code, _, err = call(app, str(folder.path), "--out", str(tmp_path / "film.gif"))
    assert code == 2
    assert err.startswith(f"{folder.id} names code of this machine: somebodys.module will be imported\n")


def test_a_policy_is_played_under_changed_settings(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    film = ("--width", "64", "--height", "48", "--out", "film.gif")
    lines = {}
    for changed in ((), ("robot=ur5",), ("task.max_steps=3",), ("task.gravity=0",)):
        code, out, err = call(app, "panda_reach", *changed, *film)
        assert (code, out) == (0, "film.gif\n"), err
        lines[changed] = err
    assert lines[()].startswith("episode 1: success")
    assert lines["robot=ur5",].startswith("episode 1: success after")
    assert "after 3 steps" in lines["task.max_steps=3",]
    assert lines["robot=ur5",] != lines[()]
    for wrong, told in (
        (("agent.discount=0.9",), "changes the training, not the test"),
        (("robot.control=joint",), "the policy was trained with other observations, actions or goals"),
    ):
        code, _, err = call(app, "panda_reach", *wrong, *film)
        assert (code, told in err) == (2, True)


def test_failures_alone_are_played_and_called_by_their_numbers(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    film = ("--width", "64", "--height", "48", "--out", "film.gif", "--failures")
    short = "task.max_steps=8"  # too few steps for the furthest goals
    code, _, err = call(app, "panda_reach", short, *film, "--episodes", "3")
    assert code == 0, err
    told = episodes(err)
    assert [line.split(": ")[1].split(" after")[0] for line in told] == ["no success"] * 3
    numbers = [int(line.split(":")[0].removeprefix("episode ")) for line in told]
    assert numbers == sorted(numbers)
    code, _, err = call(app, "panda_reach", short, *film[:-1], "--episodes", str(numbers[-1]))
    every = [line for line in episodes(err) if ": success" not in line]
    assert [int(line.split(":")[0].removeprefix("episode ")) for line in every] == numbers
