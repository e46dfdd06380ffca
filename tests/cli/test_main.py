"""What `karolos` says about itself, about wrong calls, and about runs that ended."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer
from karolos_cli.main import app, main
from karolos_cli.run import report
from support.commands import karolos, refused
from support.compared_runs import run
from support.hostile import spec
from support.run_samples import add_run

from karolos import __version__
from karolos.launchers.experiment import Outcome


@pytest.mark.parametrize(
    ("redirection", "code", "said"),
    [(">/dev/full", 3, "standard output cannot be written: No space"), (">&-", 0, "")],
)
def test_standard_output_that_is_full_or_closed_is_told_in_one_line_or_nothing(redirection, code, said):
    command = f"{sys.executable} -m karolos_cli plugins list {redirection}"
    ended = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr[: len(said) or None]) == (code, said)
    assert ended.stderr.count("\n") <= 1


def test_a_run_goes_on_if_the_reader_of_its_progress_has_ended_or_its_log_is_full(tmp_path):
    words = "run karolos:smoke/toy orchestrator.processes=0 training.steps=20 testing.episodes=2 testing.interval=10"
    command = [sys.executable, "-m", "karolos_cli", *words.split(), "--runs", str(tmp_path), "--json"]
    reader, written = os.pipe()
    os.close(reader)
    for log in (written, os.open("/dev/full", os.O_WRONLY)):
        ended = subprocess.run(command, stdout=subprocess.PIPE, stderr=log, text=True, check=False)
        os.close(log)
        assert ended.returncode == 0
        assert json.loads(ended.stdout)["state"] == "finished"


def test_a_character_that_the_encoding_of_the_output_lacks_is_escaped(tmp_path):
    name = add_run(tmp_path, 0)
    karolos("runs", "note", name, "grün", "--runs", tmp_path)
    command = [sys.executable, "-m", "karolos_cli", "runs", "list", "--columns", "note", "--runs", tmp_path]
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout) == (0, "note\ngr\\xfcn\n")


def test_a_current_folder_that_was_removed_is_told_in_one_line(tmp_path):
    command = f"cd {tmp_path}; mkdir gone; cd gone; rmdir ../gone; {sys.executable} -m karolos_cli runs list"
    ended = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr.count("\n")) == (3, 1)
    assert ended.stderr.startswith("the current folder was removed")


@pytest.mark.parametrize(
    ("trouble", "code", "said"),
    [("init:hang", 124, "stopped before a run began"), ("init:interrupt", 130, "interrupted\n")],
)
def test_an_environment_that_hangs_past_the_time_limit_or_interrupts_ends_the_command_and_says_so(
    trouble, code, said, tmp_path, monkeypatch, capsys
):
    (tmp_path / "spec.yaml").write_text(json.dumps(spec(trouble)))
    monkeypatch.setattr("karolos.experiment.signals.HANG_SECONDS", 0.1)
    command = f"karolos run {tmp_path}/spec.yaml --time-limit 1s --runs {tmp_path}"
    monkeypatch.setattr(sys, "argv", command.split())
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == code
    assert said in capsys.readouterr().err


def test_version_is_printed():
    assert karolos("--version").out == f"karolos {__version__}\n"


def test_resume_of_a_finished_run_says_that_there_is_nothing_to_do(tmp_path):
    name = add_run(tmp_path, 0)
    assert f"{name} is finished: nothing to do" in karolos("resume", tmp_path / name).err


def test_a_stopped_run_is_shown_with_the_command_that_continues_it(capsys):
    stopped = run(0, [10], state="stopped").summary
    with pytest.raises(typer.Exit):
        report(Outcome.of([stopped], 1, 130), Path("runs"), quiet=False, json=False)
    assert "`karolos resume reach-s0` continues it" in capsys.readouterr().err


def test_a_wrong_choice_is_told_without_the_class_of_the_error(monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    said = "Invalid value for '--checkpoint': 'bst' is not one of 'best', 'last'."
    for command in ("play", "test", "export"):
        assert said in refused(command, "x", "--checkpoint", "bst")


@pytest.mark.parametrize(("module", "last"), [("karolos_cli", "typer"), ("karolos.experiment.process", "pydantic")])
def test_ctrl_c_while_libraries_are_imported_is_one_line(module, last):
    code = (
        "import builtins, runpy, signal\nreal = builtins.__import__\n"
        "def hook(name, *more, **named):\n"
        f"    if name == {last!r}: signal.raise_signal(signal.SIGINT)\n"
        f"    return real(name, *more, **named)\nbuiltins.__import__ = hook\n"
        f"runpy.run_module({module!r}, run_name='__main__')"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (130, "interrupted\n")


def commands(group: typer.core.TyperGroup, *path: str) -> Iterator[tuple[str, ...]]:
    for name, command in group.commands.items():
        if isinstance(command, typer.core.TyperGroup):
            yield from commands(command, *path, name)
        else:
            yield (*path, name)


def test_help_says_what_each_option_takes(monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    for words in commands(typer.main.get_command(app)):
        options = karolos(*words, "--help").out.split("Options", 1)[1]
        assert not re.findall(r"<(?:bool|str|path|file|directory|int range|float range|list.*?)>", options), words


def test_every_command_stands_in_a_group():
    found = typer.main.get_command(app).commands.values()
    assert {command.rich_help_panel for command in found} == {"Train", "Look", "Compare", "Extend", "Keep"}
