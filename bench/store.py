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
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from functools import partial
from itertools import repeat
from pathlib import Path
from statistics import median
from typing import Any

from karolos.records import RunFolder
from karolos.records.evaluation import Evaluation
from karolos.records.provenance import versions
from karolos.records.run_records import FORMAT, RunState
from karolos.specification import spec_from_dict
from karolos.store import Store, check, query, reindex

from .side_by_side import Row, seconds_of

SEEDS = 10
"""Runs of one experiment."""
WRITES = 50
"""Transactions of each writing process."""
CURVES = 20
"""Number of different learning curves."""
FILTER = "task=pick_place and agent.learning_rate<2e-4 and state=finished"
SPEC = {"name": "store", "robot": "panda", "task": "pick_place", "agent": "sac"}


def measure(
    *,
    runs: int = 10_000,
    tests: int = 50,
    episodes: int = 100,
    writers: int = 16,
    repeats: int = 5,
    database: str | None = None,
) -> Iterator[Row]:
    """Seconds to rebuild, check and query a database of `runs` runs, and transactions per second of many writers.

    Args:
        tests: of each run.
        episodes: of each test.
        repeats: of each query, of which the median counts.
        database: URL of an empty one; by default a SQLite file.
    """

    def typical(work: Callable[[], object]) -> float:
        return median(seconds_of(work) for _ in range(repeats))

    with tempfile.TemporaryDirectory(prefix="karolos-bench-") as place:
        folder = Path(place) / "runs"
        make_runs(folder, runs, tests, episodes)
        url = database or Store.default_url(folder)
        size = f"{runs:,} runs with {tests} tests of {episodes} episodes"
        with Store(url) as store:
            reading = seconds_of(lambda: _read_all(folder))
            building = seconds_of(lambda: reindex(store, folder))
            yield Row(f"reindex, {size}", building, "s", "the time to read the JSON files", reading)
            checking = seconds_of(lambda: list(check(store, folder)))
            yield Row(f"check, {size}", checking, "s")
            found = len(store.runs(where=FILTER))
            asking, everything = typical(lambda: store.runs(where=FILTER)), typical(store.runs)
            case = f"query with a filter: {found:,} of {runs:,} runs match"
            yield Row(case, asking, "s", "the time for all runs", everything)
        listing = [sys.executable, "-m", "karolos_cli", "runs", "list"]
        call = partial(subprocess.run, check=True, stdout=subprocess.DEVNULL)
        asking = typical(lambda: call([*listing, FILTER, "--runs", str(folder), "--database", url, "--json"]))
        starting = typical(lambda: call([*listing, "--help"]))
        case = f"command `runs list` with a filter, {found:,} rows"
        yield Row(case, asking, "s", "the time of `runs list --help`", starting)
        yield _writing(Path(place), writers, database)


def _writing(place: Path, writers: int, database: str | None) -> Row:
    """Transactions per second, compared with those of SQLite alone if SQLite is the database."""
    folder = place / "writers"
    make_runs(folder, writers, tests=1, episodes=1)
    url = database or Store.default_url(folder)
    with Store(url) as store:
        for index, path in enumerate(sorted(folder.glob("store-*"))):
            record = RunFolder.open(path).record()
            store.add_records([replace(record, summary=replace(record.summary, run=f"writer-{index}"))])
    case, rate = f"{writers} processes that write at once", writers * WRITES / _together(_write, url, writers)
    if database is not None:
        return Row(case, rate, "transactions/s")
    bare = place / "bare.sqlite"
    with sqlite3.connect(bare) as connection:
        connection.execute("CREATE TABLE runs (run INTEGER PRIMARY KEY, steps INTEGER)")
        connection.executemany("INSERT INTO runs VALUES (?, 0)", [(index,) for index in range(writers)])
    bare_rate = writers * WRITES / _together(_write_bare, str(bare), writers)
    return Row(case, rate, "transactions/s", "sqlite3 with one UPDATE per transaction", bare_rate)


def _together(work: Callable[[str, int], None], where: str, writers: int) -> float:
    """Seconds until all processes are done, from the moment that all of them have started."""
    context = multiprocessing.get_context("spawn")
    start = context.Barrier(writers + 1)
    with ProcessPoolExecutor(writers, mp_context=context, initializer=start.wait) as pool:
        done = pool.map(work, repeat(where), range(writers))
        start.wait()
        return seconds_of(lambda: list(done))


def _write(url: str, index: int) -> None:
    with Store(url) as store:
        (record,) = store.records([query.find(store, f"writer-{index}")])
        for steps in range(WRITES):
            store.add_records([replace(record, summary=replace(record.summary, steps=steps))])


def _write_bare(path: str, index: int) -> None:
    connection = sqlite3.connect(path, timeout=60, isolation_level=None)
    connection.execute("PRAGMA synchronous = FULL")
    for steps in range(WRITES):
        connection.execute("BEGIN IMMEDIATE")
        connection.execute("UPDATE runs SET steps = ? WHERE run = ?", (steps, index))
        connection.execute("COMMIT")


def make_runs(folder: Path, runs: int, tests: int, episodes: int) -> None:
    """Write the folders of finished runs, SEEDS per experiment, with learning rates of 1e-4 and more."""
    curves = [_curve(index, tests, episodes) for index in range(min(CURVES, runs))]
    spec, software = spec_from_dict(dict(SPEC)).dump(), versions()
    for index in range(runs):
        experiment, seed = divmod(index, SEEDS)
        path = folder / f"store-s{seed}-20260101-{experiment:06}"
        path.mkdir(parents=True)
        run = {"format": FORMAT, "id": path.name, "name": "store", "seed": seed, "experiment": f"{experiment:064x}"}
        run |= {"created": f"2026-01-01T00:00:00.{index:06}Z", "versions": software}
        state = RunState("finished", tests * 1000, tests * 10.0, 1, None, f"2026-01-01T01:00:00.{index:06}Z")
        resolved = spec | {"agent": spec["agent"] | {"learning_rate": 1e-4 * (1 + experiment % 97)}}
        for file, value in (("resolved.json", resolved), ("run.json", run), ("state.json", asdict(state))):
            (path / file).write_text(json.dumps(value, indent=2))
        (path / "tests.jsonl").write_text(curves[index % len(curves)])
        (path / "events.jsonl").write_text('{"time":"2026-01-01T00:00:00.000000Z","event":"started"}\n')


def _curve(index: int, tests: int, episodes: int) -> str:
    lines = []
    for test in range(1, tests + 1):
        success = test / (test + 2 + index)
        flags = tuple((episode * 37 + index) % episodes < success * episodes for episode in range(episodes))
        returns = tuple(-50.0 * (1 - success) - episode / 7 for episode in range(episodes))
        lists: dict[str, Any] = {"any": flags, "end": flags, "reset": (False,) * episodes, "returns": returns}
        lists |= {"lengths": (50,) * episodes, "distances": (0.0625,) * episodes}
        result = Evaluation.of(test * 1000, test * 10.0, **lists)
        lines.append(json.dumps(result.encode(), separators=(",", ":")))
    return "\n".join(lines) + "\n"


def _read_all(folder: Path) -> None:
    """Read the files and their JSON: the least that rebuilding the database takes."""
    for path in folder.glob("*/*.json*"):
        content = path.read_bytes()
        for text in content.splitlines() if path.suffix == ".jsonl" else [content]:
            json.loads(text)
