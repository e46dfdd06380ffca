"""What `karolos` says about itself and about runs that ended."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from karolos_cli.main import app, main
from karolos_cli.run import report
from support.compared_runs import run
from support.hostile import spec
from support.run_commands import call
from support.run_samples import add_run

from karolos import __version__
from karolos.launchers.experiment import Outcome


def test_standard_output_that_is_full_or_closed_is_told_in_one_line_or_nothing():
    for redirection, code, err in ((">/dev/full", 3, "standard output cannot be written: No space"), (">&-", 0, "")):
        ended = subprocess.run(
            f"{sys.executable} -m karolos_cli plugins list {redirection}",
            shell=True,
            capture_output=True,
            text=True,
            check=False,
        )
        assert (ended.returncode, ended.stderr[: len(err) or None]) == (code, err)
        assert ended.stderr.count("\n") <= 1


@pytest.mark.parametrize(
    ("trouble", "code", "said"),
    [("init:hang", 124, "stopped before a run began"), ("init:interrupt", 130, "interrupted\n")],
)
def test_an_environment_that_hangs_past_the_time_limit_or_interrupts_ends_the_command_and_says_so(
    trouble, code, said, tmp_path, monkeypatch, capsys
):
    (tmp_path / "spec.yaml").write_text(json.dumps(spec(trouble)))
    monkeypatch.setattr("karolos.experiment.signals.HANG_SECONDS", 0.1)
    monkeypatch.setattr(
        sys, "argv", ["karolos", "run", f"{tmp_path}/spec.yaml", "--time-limit", "1s", "--runs", f"{tmp_path}"]
    )
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == code
    assert said in capsys.readouterr().err


def test_version_is_printed():
    assert call(app, "--version").stdout == f"karolos {__version__}\n"


def test_resume_of_a_finished_run_says_that_there_is_nothing_to_do(tmp_path):
    name = add_run(tmp_path, 0)
    assert f"{name} is finished: nothing to do" in call(app, "resume", tmp_path / name).stderr


def test_a_stopped_run_is_shown_with_the_command_that_continues_it(capsys):
    stopped = run(0, [10], state="stopped").summary
    with pytest.raises(typer.Exit):
        report(Outcome.of([stopped], 1, 130), Path("runs"), quiet=False, json=False)
    assert "`karolos resume reach-s0` continues it" in capsys.readouterr().err


def test_a_wrong_choice_is_told_without_the_class_of_the_error(monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    said = call(app, "play", "x", "--checkpoint", "bst", exit_code=2).stderr
    assert "Invalid value for '--checkpoint': 'bst' is not one of 'best', 'last'." in said


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
