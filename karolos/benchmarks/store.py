"""How fast the results database answers, is rebuilt, and takes what many processes write at once.

The runs are made up: folders as a run leaves them, ten seeds to an experiment, learning curves that rise and level off.
"""

from __future__ import annotations

import json
import multiprocessing
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from multiprocessing.synchronize import Barrier
from pathlib import Path
from statistics import median
from time import perf_counter

from ..errors import RunError
from ..orchestrator.probe import cores
from ..records.provenance import versions
from ..records.results import TestResult
from ..records.run_records import FORMAT, RunState, RunSummary, encode_test
from ..spec import Spec
from ..store import Store, check, reindex
from .row import Row

SEEDS = 10
"""Runs of one experiment."""
WRITES = 50
"""Transactions of each process that writes."""
CURVES = 20
"""Different learning curves; the runs take them in turn."""
REPEATS = 5
FILTER = "task=pick_place and agent.learning_rate<2e-4 and state=finished"
SPEC = {"name": "store", "robot": "panda", "task": "pick_place", "agent": "sac"}


def measure(*, runs: int, tests: int, episodes: int, writers: int = 16, database: str | None = None) -> Iterator[Row]:
    """Seconds and transactions per second.

    Args:
        runs: how many there are.
        tests: of each run.
        episodes: of each test.
        writers: processes that write at once.
        database: URL of an empty database to measure instead of a SQLite file; it is filled.
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
    url = database or Store.default_url(place / "writers")
    with Store(url) as store:
        for index in range(writers):
            store.add_run(_summary(place, index), SPEC)
    ours = _together(_write, url, writers)
    kept = database is None
    peer = None
    if kept:
        bare = place / "bare.sqlite"
        with sqlite3.connect(bare) as connection:
            connection.execute("CREATE TABLE runs (run INTEGER PRIMARY KEY, steps INTEGER)")
            connection.executemany("INSERT INTO runs VALUES (?, 0)", [(index,) for index in range(writers)])
        peer = writers * WRITES / _together(_write_bare, str(bare), writers)
    rate = writers * WRITES / ours
    name = "sqlite3, one bare UPDATE" if kept else None
    yield Row("store", f"{writers} processes that write at once", rate, "transactions/s", name, peer)


def _together(work: Callable[[str, int], None], where: str, writers: int) -> float:
    """Seconds that processes take from the moment that all of them have started."""
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
        raise RunError("a process that writes failed", where="bench store", hint="what it printed says why")
    return perf_counter() - started


def _after(barrier: Barrier, work: Callable[[str, int], None], where: str, index: int) -> None:
    barrier.wait()
    work(where, index)


def _write(url: str, index: int) -> None:
    with Store(url) as store:
        for steps in range(WRITES):
            store.update_run(replace(_summary(Path(), index), steps=steps))


def _write_bare(path: str, index: int) -> None:
    connection = sqlite3.connect(path, timeout=60, isolation_level=None)
    connection.execute("PRAGMA synchronous = FULL")
    for steps in range(WRITES):
        connection.execute("BEGIN IMMEDIATE")
        connection.execute("UPDATE runs SET steps = ? WHERE run = ?", (steps, index))
        connection.execute("COMMIT")


def _summary(place: Path, index: int) -> RunSummary:
    return RunSummary(
        run=f"w-s{index}",
        experiment="w",
        seed=index,
        state="finished",
        steps=0,
        seconds=0.0,
        success_any=None,
        success_end=None,
        steps_to_95=None,
        seconds_to_95=None,
        name="w",
        episodes=None,
        environment="toy",
        robot=None,
        task=None,
        agent="sac",
        attempt=1,
        error=None,
        created="2026-01-01T00:00:00.000000Z",
        updated="2026-01-01T00:00:00.000000Z",
        folder=str(place / f"w-s{index}"),
    )


def make_runs(folder: Path, runs: int, tests: int, episodes: int) -> None:
    """Run folders of finished runs, SEEDS to an experiment; learning rates from 1e-4 on."""
    curves = [_curve(index, tests, episodes) for index in range(min(CURVES, runs))]
    spec = Spec.from_dict(dict(SPEC)).dump()
    software = versions()
    for index in range(runs):
        experiment, seed = divmod(index, SEEDS)
        name = f"store-s{seed}-20260101-{experiment:06}"
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
        files = {"resolved.json": resolved, "run.json": run, "state.json": state.to_row()}
        for file, value in files.items():
            (path / file).write_text(json.dumps(value, indent=2))
        (path / "tests.jsonl").write_text(curves[index % len(curves)])
        (path / "events.jsonl").write_text('{"time":"2026-01-01T00:00:00.000000Z","event":"started"}\n')


def _curve(index: int, tests: int, episodes: int) -> str:
    lines = []
    for test in range(1, tests + 1):
        share = test / (test + 2 + index)
        flags = tuple((episode * 37 + index) % episodes < share * episodes for episode in range(episodes))
        returns = tuple(-50.0 * (1 - share) - episode / 7 for episode in range(episodes))
        result = TestResult(
            test * 1000, test * 10.0, flags, flags, (False,) * episodes, returns, (50,) * episodes, (0.0625,) * episodes
        )
        lines.append(json.dumps(encode_test(result), separators=(",", ":")))
    return "\n".join(lines) + "\n"


def _read_all(folder: Path) -> None:
    """What no way to rebuild the database can leave out: reading the files and their JSON."""
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
