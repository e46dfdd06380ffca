"""The README's commands work one after the other, in its order, at toy size."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from karolos_cli.main import app
from support.commands import call

ROOT = Path(__file__).parents[2]
SMALL = [
    *("training.steps=40", "training.replay_ratio=1", "training.warmup_episodes=1", "training.batch_size=8"),
    *("testing.interval=20", "testing.episodes=2", "testing.final_episodes=2", "task.max_steps=10"),
    *("orchestrator.processes=0", "orchestrator.environments=2", "agent.hidden=[8]"),
]
"""Overrides that make a run end within seconds."""
SMALLER = {
    "run": [*SMALL, "--quiet"],
    "sweep": [
        *(one for one in SMALL if "hidden" not in one),
        *("sweep.final=null", "sweep.seeds=[0]", "--trials", "1", "--quiet"),
    ],
    "test": ["--episodes", "2"],
    "play": ["--episodes", "1", "--width", "64", "--height", "48"],
}
ENDLESS = ("board",)
"""Commands that go on until they are interrupted."""


def commands() -> list[list[str]]:
    """The karolos commands of the README's shell blocks, in order."""
    blocks = re.findall(r"```sh\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    lines = [part for block in blocks for line in block.splitlines() for part in line.split(" && ")]
    return [shlex.split(line, comments=True)[1:] for line in lines if line.startswith("karolos ")]


def test_commands_work_in_the_order_of_the_readme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "specs").symlink_to(ROOT / "specs")
    monkeypatch.chdir(tmp_path)
    found = commands()
    assert [words[0] for words in found[:3]] == ["run", "runs", "runs"]
    assert {"play", "compare", "diff", "test", "export", "resume", "sweep"} <= {words[0] for words in found}
    for words in found:
        if words[0] not in ENDLESS:
            code, out, err = call(app, *words, *SMALLER.get(words[0], []))
            assert code == 0, f"karolos {shlex.join(words)}\n{out}{err}"
    assert (tmp_path / "reach.mp4").is_file()
    assert (tmp_path / "compare.html").is_file()
    assert list((tmp_path / "runs").glob("panda_reach-*/export/policy.npz"))


def test_every_command_says_how_long_it_takes() -> None:
    block = re.search(
        r"```sh\n(karolos runs list .*?)```.*?```sh\n(karolos run .*?)```", (ROOT / "README.md").read_text(), re.DOTALL
    )
    assert block is not None
    for line in (block[1] + block[2]).splitlines():
        assert re.search(r"#.*(\d s\b|minute|hour|until Ctrl-C|a finished run stays)", line), line
