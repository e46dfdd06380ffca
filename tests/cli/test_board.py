"""`karolos board` shows the runs of a folder, without those of sweeps' trials."""

from __future__ import annotations

from pathlib import Path

from karolos_cli.board import link_runs
from support.sweep_samples import some_trial, write_sweep
from tensorboard.backend.event_processing.io_wrapper import GetLogdirSubdirectories
from tensorboard.summary.writer.event_file_writer import EventFileWriter


def make_run(runs: Path, name: str) -> None:
    folder = runs / name / "tensorboard"
    folder.mkdir(parents=True)
    EventFileWriter(str(folder)).close()


def test_tensorboard_finds_the_runs_that_are_not_of_a_trial_also_those_that_begin_later(tmp_path: Path) -> None:
    runs, links = tmp_path / "runs", tmp_path / "links"
    links.mkdir()
    write_sweep(runs, "x", [some_trial(0)])
    for name in ("reach-s0-20260101-000000", "x-t000-s0-20260101-000000"):
        make_run(runs, name)
    link_runs(runs, links)
    make_run(runs, "reach-s1-20260101-000000-2")
    link_runs(runs, links)
    found = sorted(Path(folder).name for folder in GetLogdirSubdirectories(str(links)))
    assert found == ["reach-s0-20260101-000000", "reach-s1-20260101-000000-2"]
