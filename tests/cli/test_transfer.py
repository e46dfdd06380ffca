"""`karolos transfer`: what it prints and writes, and how it ends after a stop."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import typer
import yaml
from karolos_cli.transfer import transfer
from support.commands import call
from support.fake_launcher import FakeLauncher
from support.transfer_samples import LINE

app = typer.Typer()
app.command()(transfer)
SMALL = ("training.steps=40", "seeds=[0]", "transfer.modes=[zero_shot]", "transfer.fine_tune=null")


def test_a_stopped_matrix_says_how_to_go_on_and_then_reports(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr("karolos.launchers.driver.make_launcher", lambda *_: FakeLauncher())
    Path("line.yaml").write_text(yaml.safe_dump(LINE))
    code, _, err = call(app, "line.yaml", *SMALL, "--out", "x.html")
    assert (code, "--out: cannot write figures into 'x.html'; name a folder; a" in err) == (2, True)
    code, out, err = call(app, "line.yaml", *SMALL, "--time-limit", "0.001s")
    assert (code, out) == (124, "")
    assert "line is stopped: the same command with --resume continues it" in err
    code, out, err = call(app, "line.yaml", *SMALL, "--resume", "--json", "--out", "figures")
    assert code == 0, err
    assert [(row["source"], row["target"]) for row in map(json.loads, out.splitlines())][1] == ("fast", "slow")
    assert "2 sources of 40 steps, 2 tests of 10 episodes" in err
    assert Path("runs/transfers/line/report.html").is_file()
    assert {path.name for path in Path("figures").iterdir()} >= {"transfer_zero_shot.pdf", "transfer_retention.svg"}
    code, out, err = call(app, "line.yaml", *SMALL, "--resume", "--quiet")
    assert (code, out, err) == (0, "", "")
    code, out, _ = call(app, "line.yaml", *SMALL, "--resume")
    assert code == 0
    for word in ("Zero-shot success", "from", "to slow", "random policy", "Wilson"):
        assert word in out
    assert max(map(len, out[: out.index("Zero-shot success:")].splitlines())) <= 100
