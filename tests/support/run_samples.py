"""Spec and folders of small runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from karolos.records import RunFolder
from karolos.records.results import TestResult

SPEC = {"name": "reach", "environment": {"name": "toy"}, "robot": None, "agent": {"name": "sac"}, "seeds": [3]}


def result(steps: int, successes: int, episodes: int = 20) -> TestResult:
    flags = tuple(index < successes for index in range(episodes))
    return TestResult(steps, steps / 100, flags, flags[::-1], (False,) * episodes, (-1.5,) * episodes, (9,) * episodes)


def new_run(runs: Path, **options: Any) -> RunFolder:
    folder = RunFolder.create(runs, "reach", 3)
    folder.describe(SPEC, experiment="abc", **options)
    return folder
