"""Run folders and calls for tests of `karolos runs` and `karolos db`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import typer
from typer.testing import CliRunner, Result

from karolos.errors import KarolosError
from karolos.records import RunFolder
from karolos.records.results import TestResult
from karolos.store import Store


def call(app: typer.Typer, *arguments: object, exit_code: int = 0) -> Result:
    """Run a command; a KarolosError, which `karolos` prints as one line, is raised here."""
    ended = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if isinstance(ended.exception, KarolosError):
        raise ended.exception
    if ended.exception is not None and not isinstance(ended.exception, SystemExit):
        raise ended.exception
    assert ended.exit_code == exit_code, ended.output
    return ended


def rows(app: typer.Typer, *arguments: object) -> list[dict[str, Any]]:
    return [json.loads(line) for line in call(app, *arguments, "--json").stdout.splitlines()]


def add_run(
    runs: Path, seed: int, rate: float = 0.001, name: str = "reach", *, state: Any = "finished", solved: int = 19
) -> str:
    """A run with one test, in the index, of an experiment that the first word of its name tells; returns its id."""
    flags = (True,) * solved + (False,) * (20 - solved)
    test = TestResult(1000, 10.0, flags, flags, (False,) * 20, (0.0,) * 20, (9,) * 20)
    spec = {"name": name, "task": {"name": "reach"}, "agent": {"name": "sac", "learning_rate": rate}}
    with RunFolder.create(runs, name, seed) as run, Store(Store.default_url(runs)) as store:
        run.describe(spec, experiment=name.partition("-")[0].encode().hex().ljust(64, "0"), source=runs)
        run.add_test(test)
        run.set_state(state, steps=1200, seconds=12.5)
        store.add_records([run.record()])
        return run.id
