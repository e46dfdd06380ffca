"""What help says of options."""

import re
from collections.abc import Iterator

import typer
from karolos_cli.main import app
from typer.testing import CliRunner


def commands(group: typer.core.TyperGroup, path: str = "karolos") -> Iterator[tuple[str, typer.core.TyperCommand]]:
    for name, command in group.commands.items():
        if isinstance(command, typer.core.TyperGroup):
            yield from commands(command, f"{path} {name}")
        else:
            yield f"{path} {name}", command


def test_help_says_what_each_option_takes(monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    for name, _ in commands(typer.main.get_command(app)):
        shown = CliRunner().invoke(app, [*name.split()[1:], "--help"]).stdout
        options = shown.split("Options", 1)[1]
        assert not re.findall(r"<(?:bool|str|path|file|directory|int range|float range|list.*?)>", options), name


def test_every_command_stands_in_a_group():
    found = typer.main.get_command(app).commands.values()
    assert {command.rich_help_panel for command in found} == {"Train", "Look", "Compare", "Extend", "Keep"}
