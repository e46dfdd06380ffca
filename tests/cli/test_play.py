from __future__ import annotations

from pathlib import Path

import imageio.v3 as imageio
import pytest
from commands import call
from karolos_cli.play import play
from typer import Typer

app = Typer()
app.command()(play)
SPEC = "name: tiny\nrobot: panda\ntask: {name: reach, max_steps: 6}\nagent: sac\n"


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.yaml"
    path.write_text(SPEC)
    return path


def test_the_expert_of_a_spec_is_filmed_and_its_episodes_are_told(spec: Path, tmp_path: Path) -> None:
    film = tmp_path / "film.gif"
    size = ("--width", "64", "--height", "48")
    code, out, err = call(app, str(spec), "--expert", "--record", str(film), "--episodes", "2", *size)
    assert code == 0, err
    assert out.strip() == str(film)
    assert [line.split(":")[0] for line in err.splitlines()] == ["episode 1", "episode 2"]
    assert "after 6 steps" in err
    pictures = imageio.imread(film)
    assert pictures.shape[1:3] == (48, 64)
    assert len(pictures) >= 7, "the arm moves"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--width", "65"), "cannot be coded"),
        (("--record", "film.txt"), "cannot record"),
        (("--checkpoint", "worst"), "there is no checkpoint 'worst'"),
    ],
)
def test_what_cannot_be_filmed_is_refused(spec: Path, arguments: tuple[str, ...], message: str) -> None:
    defaults = () if "--record" in arguments else ("--record", str(spec.with_suffix(".gif")))
    code, _, err = call(app, str(spec), "--expert", *defaults, *arguments)
    assert code == 2
    assert message in err


def test_a_spec_without_a_task_has_no_expert(tmp_path: Path) -> None:
    path = tmp_path / "toy.yaml"
    path.write_text("name: toy\nenvironment: toy\nagent: sac\n")
    code, _, err = call(app, str(path), "--expert", "--record", str(tmp_path / "film.gif"))
    assert code == 2
    assert "there is no expert for this environment" in err
