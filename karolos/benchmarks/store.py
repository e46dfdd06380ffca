"""How fast the results database answers, is rebuilt, and is written to by many processes at once.

The runs are synthetic: complete run folders, ten seeds per experiment, learning curves that rise and level off.
"""

from __future__ import annotations

import json
import multiprocessing
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from multiprocessing.synchronize import Barrier
from pathlib import Path
from statistics import median
from time import perf_counter

from ..errors import RunError
from ..machine import cores
from ..records import RunFolder
from ..records.provenance import versions
from ..records.results import TestResult, encode_test
from ..records.run_records import FORMAT, RunState
from ..spec import spec_from_dict
from ..store import Store, check, reindex
from .side_by_side import Row

SEEDS = 10
"""Runs of one experiment."""
WRITES = 50
"""Transactions of each writing process."""
CURVES = 20
"""Number of different learning curves."""
REPEATS = 5
FILTER = "task=pick_place and agent.learning_rate<2e-4 and state=finished"
SPEC = {"name": "store", "robot": "panda", "task": "pick_place", "agent": "sac"}


def measure(*, runs: int, tests: int, episodes: int, writers: int = 16, database: str | None = None) -> Iterator[Row]:
    """Seconds and transactions per second.

    Args:
        runs: number of runs in the database.
        tests: of each run.
        episodes: of each test.
        writers: processes that write at once.
        database: URL of an empty database to fill and measure; by default a SQLite file.
    """
    with tempfile.TemporaryDirectory(prefix="karolos-bench-") as place:
        folder = Path(place) / "runs"
        make_runs(folder, runs, tests, episodes)
        url = database or Store.default_url(folder)
        jobs = cores()
        size = f"{runs:,} runs with {tests} tests of {episodes} episodes"
        with Store(url) as store:
            name = f"reindex by {jobs} processes, {size}"
            reading = _seconds(lambda: _read_all(folder))
            building = _seconds(lambda: reindex(store, folder, jobs=jobs))
            yield Row("store", name, building, "s", "one process reads the JSON alone", reading)
            checking = _seconds(lambda: list(check(store, folder, jobs=jobs)))
            yield Row("store", f"check by {jobs} processes, {size}", checking, "s")
            found = len(store.runs(where=FILTER))
            asking = median(_seconds(lambda: store.runs(where=FILTER)) for _ in range(REPEATS))
            everything = median(_seconds(store.runs) for _ in range(REPEATS))
            yield Row("store", f"filter that {found:,} of {runs:,} runs fit", asking, "s", "all runs", everything)
        yield from _commands(folder, url, found)
        yield from _writers(Path(place), writers, database)


def _commands(folder: Path, url: str, found: int) -> Iterator[Row]:
    """The whole command, the interpreter's start and imports included."""
    program = [sys.executable, "-m", "karolos_cli"]
    listing = [*program, "runs", "list", FILTER, "--runs", str(folder), "--database", url, "--json"]
    asking = median(_seconds(lambda: _call(listing)) for _ in range(REPEATS))
    starting = median(_seconds(lambda: _call([*program, "runs", "list", "--help"])) for _ in range(REPEATS))
    yield Row("store", f"command `runs list` with a filter, {found:,} rows", asking, "s", "its --help", starting)


def _writers(place: Path, writers: int, database: str | None) -> Iterator[Row]:
    folder = place / "writers"
    make_runs(folder, writers, tests=1, episodes=1)
    url = database or Store.default_url(folder)
    with Store(url) as store:
        for index in range(writers):
            record = RunFolder.open(folder / _run_id(index)).record()
            store.add_records([replace(record, summary=replace(record.summary, run=f"writer-{index}"))])
    case = f"{writers} processes that write at once"
    rate = writers * WRITES / _together(_write, url, writers)
    if database is not None:
        yield Row("store", case, rate, "transactions/s")
        return
    bare = place / "bare.sqlite"
    with sqlite3.connect(bare) as connection:
        connection.execute("CREATE TABLE runs (run INTEGER PRIMARY KEY, steps INTEGER)")
        connection.executemany("INSERT INTO runs VALUES (?, 0)", [(index,) for index in range(writers)])
    bare_rate = writers * WRITES / _together(_write_bare, str(bare), writers)
    yield Row("store", case, rate, "transactions/s", "sqlite3, one bare UPDATE", bare_rate)


def _together(work: Callable[[str, int], None], where: str, writers: int) -> float:
    """Seconds until all processes have ended, from the moment that all of them have started."""
    context = multiprocessing.get_context("spawn")
    barrier = context.Barrier(writers + 1)
    processes = [context.Process(target=_after, args=(barrier, work, where, at)) for at in range(writers)]
    for process in processes:
        process.start()
    barrier.wait()
    started = perf_counter()
    for process in processes:
        process.join()
    if any(process.exitcode for process in processes):
        raise RunError("a writing process failed", where="bench store", hint="its error is printed above")
    return perf_counter() - started


def _after(barrier: Barrier, work: Callable[[str, int], None], where: str, index: int) -> None:
    barrier.wait()
    work(where, index)


def _write(url: str, index: int) -> None:
    with Store(url) as store:
        (record,) = store.records([store.find(f"writer-{index}")])
        for steps in range(WRITES):
            store.add_records([replace(record, summary=replace(record.summary, steps=steps))])


def _write_bare(path: str, index: int) -> None:
    connection = sqlite3.connect(path, timeout=60, isolation_level=None)
    connection.execute("PRAGMA synchronous = FULL")
    for steps in range(WRITES):
        connection.execute("BEGIN IMMEDIATE")
        connection.execute("UPDATE runs SET steps = ? WHERE run = ?", (steps, index))
        connection.execute("COMMIT")


def _run_id(index: int) -> str:
    experiment, seed = divmod(index, SEEDS)
    return f"store-s{seed}-20260101-{experiment:06}"


def make_runs(folder: Path, runs: int, tests: int, episodes: int) -> None:
    """Write the folders of finished runs, SEEDS per experiment, with learning rates of 1e-4 and more."""
    curves = [_curve(index, tests, episodes) for index in range(min(CURVES, runs))]
    spec = spec_from_dict(dict(SPEC)).dump()
    software = versions()
    for index in range(runs):
        experiment, seed = divmod(index, SEEDS)
        name = _run_id(index)
        path = folder / name
        path.mkdir(parents=True)
        resolved = spec | {"agent": spec["agent"] | {"learning_rate": 1e-4 * (1 + experiment % 97)}}
        run = {
            "format": FORMAT,
            "id": name,
            "name": "store",
            "seed": seed,
            "experiment": f"{experiment:064x}",
            "created": f"2026-01-01T00:00:00.{index:06}Z",
            "versions": software,
        }
        state = RunState("finished", tests * 1000, tests * 10.0, 1, None, f"2026-01-01T01:00:00.{index:06}Z")
        files = {"resolved.json": resolved, "run.json": run, "state.json": asdict(state)}
        for file, value in files.items():
            (path / file).write_text(json.dumps(value, indent=2))
        (path / "tests.jsonl").write_text(curves[index % len(curves)])
        (path / "events.jsonl").write_text('{"time":"2026-01-01T00:00:00.000000Z","event":"started"}\n')


def _curve(index: int, tests: int, episodes: int) -> str:
    lines = []
    for test in range(1, tests + 1):
        success = test / (test + 2 + index)
        flags = tuple((episode * 37 + index) % episodes < success * episodes for episode in range(episodes))
        returns = tuple(-50.0 * (1 - success) - episode / 7 for episode in range(episodes))
        result = TestResult(
            test * 1000, test * 10.0, flags, flags, (False,) * episodes, returns, (50,) * episodes, (0.0625,) * episodes
        )
        lines.append(json.dumps(encode_test(result), separators=(",", ":")))
    return "\n".join(lines) + "\n"


def _read_all(folder: Path) -> None:
    """Read the files and their JSON: the least that rebuilding the database takes."""
    for path in folder.iterdir():
        if path.is_dir():
            for name in ("run.json", "resolved.json", "state.json"):
                json.loads((path / name).read_bytes())
            for name in ("tests.jsonl", "events.jsonl"):
                for line in (path / name).read_bytes().splitlines():
                    json.loads(line)


def _call(command: list[str]) -> None:
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def _seconds(work: Callable[[], object]) -> float:
    started = perf_counter()
    work()
    return perf_counter() - started
