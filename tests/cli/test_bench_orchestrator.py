"""karolos bench orchestrator: what it writes, and where."""

from __future__ import annotations

from pathlib import Path

import pytest
from karolos_cli.bench import orchestrator
from support.commands import call
from typer import Typer

from karolos.benchmarks.orchestrator import Report
from karolos.report.figures import BoxPlot

app = Typer()
app.command()(orchestrator)


@pytest.fixture(autouse=True)
def measured(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Nothing is measured, and the current folder is an empty one."""
    found = Report(plots=[BoxPlot("resets", "processes", "s", {"1": [1.0, 2.0]})], advice=["use 2 processes"])
    monkeypatch.setattr("karolos.benchmarks.orchestrator.measure", lambda *_: found)
    monkeypatch.chdir(tmp_path)


def test_nothing_is_written_that_was_not_asked_for(tmp_path: Path) -> None:
    code, _, err = call(app)
    assert code == 0, err
    assert err.splitlines() == ["use 2 processes"]
    assert list(tmp_path.iterdir()) == []


def test_the_box_plots_are_where_it_says(tmp_path: Path) -> None:
    code, _, err = call(app, "--out", "boxes.svg")
    assert code == 0, err
    assert err.splitlines() == ["use 2 processes", "wrote the box plots into boxes.svg"]
    assert "<svg" in (tmp_path / "boxes.svg").read_text()


def test_a_figure_that_is_no_picture_is_refused_before_anything_is_measured() -> None:
    code, out, err = call(app, "--out", "boxes.txt")
    assert (code, out) == (2, "")
    assert "boxes.txt has no file extension of a picture; let it end in .svg, .pdf, .png" in err
