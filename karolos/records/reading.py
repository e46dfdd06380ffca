"""What the files of a run folder say, damaged ones too."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..errors import RunError
from ..files import parse_object, read_lines
from .counting import TestCounts, count_lines
from .results import TestResult
from .run_records import FORMAT, RunState, decode_test, is_description


def read_description(path: Path) -> dict[str, Any]:
    """What run.json in the run folder `path` holds.

    Raises:
        RunError: it is no run folder, or a newer karolos made it.
    """
    try:
        run = parse_object((path / "run.json").read_bytes())
    except OSError as error:
        raise RunError(
            f"this is no run folder ({error.strerror})", where=str(path), hint="`karolos runs list` shows the runs"
        ) from error
    if run is None or not is_description(run):
        raise RunError("run.json is damaged", where=str(path), hint="restore the folder from a copy, or remove it")
    if run["format"] > FORMAT:
        raise RunError("a newer karolos made this run folder", where=str(path), hint="update karolos")
    return run


def read_object(path: Path) -> dict[str, Any] | None:
    """The JSON object in a file; None where there is none."""
    try:
        return parse_object(path.read_bytes())
    except OSError:
        return None


def read_state(path: Path) -> RunState:
    """The state as it was written into the run folder `path`; `created` where it cannot be read."""
    return RunState.from_row(read_object(path / "state.json") or {})


def read_tests(path: Path) -> tuple[tuple[TestResult, ...], tuple[str, ...]]:
    """The tests in the run folder `path` in the order of their steps, and what is damaged, one line each."""
    rows, problems = read_lines(path / "tests.jsonl")
    decoded = [decode_test(row) for row in rows]
    unique = {result.steps: result for result in decoded if result is not None}
    odd = decoded.count(None)
    if odd:
        problems += (f"tests.jsonl: {odd} lines are no test results; left out",)
    return tuple(unique[steps] for steps in sorted(unique)), problems


def count_tests(path: Path) -> tuple[tuple[TestCounts, ...], tuple[str, ...]]:
    """As `read_tests`, but the tests by their counts, which is quicker where nothing is damaged."""
    try:
        counted = count_lines((path / "tests.jsonl").read_bytes())
    except OSError:
        counted = None
    if counted is None:
        results, problems = read_tests(path)
        return tuple(TestCounts.of(result) for result in results), problems
    unique = {test.steps: test for test in counted}
    return tuple(unique[steps] for steps in sorted(unique)), ()
