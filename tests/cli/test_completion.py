"""Shell completion of run ids and plugins; what help says of options."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer
from karolos_cli.main import app
from typer.testing import CliRunner

ROOT = Path(__file__).parents[2]


def words(line: str) -> dict[str, str]:
    """The environment in which bash asks for completions of the last word."""
    return {"COMP_WORDS": line, "COMP_CWORD": str(line.count(" ")), "_KAROLOS_COMPLETE": "complete_bash"}


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("karolos runs show re", "reach reach-s0"),
        ("karolos play @", "@last"),
        ("karolos plugins show buf", "buffer"),
        ("karolos plugins show agent s", "sac"),
        ("karolos inspect robot u", "ur5"),
        ("karolos compare reach --metric e", "end"),
    ],
)
def test_runs_and_plugins_are_completed(
    line: str, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "reach-s0").mkdir()
    (tmp_path / "reach-s0" / "run.json").write_text("{}")
    monkeypatch.chdir(ROOT)
    completed = CliRunner().invoke(app, [], prog_name="karolos", env=words(line) | {"KAROLOS_RUNS": str(tmp_path)})
    assert completed.stdout.split() == expected.split()


def commands(group: typer.core.TyperGroup, path: str = "karolos") -> Iterator[tuple[str, typer.core.TyperCommand]]:
    for name, command in group.commands.items():
        if isinstance(command, typer.core.TyperGroup):
            yield from commands(command, f"{path} {name}")
        else:
            yield f"{path} {name}", command


def test_help_says_what_each_option_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    for name, _ in commands(typer.main.get_command(app)):
        shown = CliRunner().invoke(app, [*name.split()[1:], "--help"]).stdout
        options = shown.split("Options", 1)[1]
        assert not re.findall(r"<(?:bool|str|path|file|directory|int range|float range|list.*?)>", options), name
