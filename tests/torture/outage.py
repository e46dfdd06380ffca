"""Make the database unreachable in the middle of an experiment of 4 seeds with --jobs 2, and bring it back.

    python tests/torture/outage.py [--database postgresql://...] [--seconds 4] [--never-back]

The command has to end with 0: every seed finishes, because the run folder is the truth. Warnings name the database.
Afterwards `karolos db reindex` enters what is missing, and `karolos db check` finds no difference. By default the
database is the SQLite file in the runs folder, which is moved away. A PostgreSQL server is reached through a relay
(`--database` is its URL), which refuses connections and breaks those that exist. Ends with 1 if something differs.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sqlalchemy import make_url

from karolos.store import Store

SPEC = """
name: outage
seeds: [0, 1, 2, 3]
environment: toy
agent: {name: sac, hidden: [16], precision: float32}
buffer: {capacity: 2000}
orchestrator: {processes: 0, environments: 4}
training: {steps: STEPS, batch_size: 16, replay_ratio: 8, warmup_episodes: 4}
testing: {interval: 100, episodes: 4}
"""


class Relay:
    """Passes connections on to a server, as long as it is up."""

    def __init__(self, host: str, port: int) -> None:
        self._server, self._open = (host, port), []
        self._up = True
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            client, _ = self._listener.accept()
            if not self._up:
                client.close()
                continue
            server = socket.create_connection(self._server)
            self._open += [client, server]
            for pair in ((client, server), (server, client)):
                threading.Thread(target=self._pass_on, args=pair, daemon=True).start()

    @staticmethod
    def _pass_on(source: socket.socket, target: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(65536):
                target.sendall(data)
        for one in (source, target):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def down(self) -> None:
        self._up = False
        for one in self._open:
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
        self._open.clear()

    def up(self) -> None:
        self._up = True


@contextmanager
def database(url: str | None, runs: Path) -> Iterator[tuple[str, Callable[[], None], Callable[[], None]]]:
    """URL of a database, and what takes it away and brings it back."""
    if url is None:
        file, aside = runs / "karolos.sqlite", runs / "aside"

        def down() -> None:
            file.rename(aside)
            file.mkdir()

        def up() -> None:
            file.rmdir()
            aside.rename(file)

        yield Store.default_url(runs), down, up
        return
    server = make_url(url)
    relay = Relay(server.host or "127.0.0.1", server.port or 5432)
    relayed = server.set(host="127.0.0.1", port=relay.port)
    yield relayed.render_as_string(hide_password=False), relay.down, relay.up


def karolos(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "karolos_cli", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


def outage(runs: Path, url: str | None, seconds: float, *, steps: int, back: bool = True) -> list[str]:
    """What differs from what is promised."""
    runs.mkdir(parents=True, exist_ok=True)
    spec = runs.parent / "outage.yaml"
    spec.write_text(SPEC.replace("STEPS", str(steps)))
    with database(url, runs) as (reached, down, up):
        where = ("--runs", str(runs), "--database", reached)
        command = [sys.executable, "-m", "karolos_cli", "run", str(spec), *where, "--jobs", "2", "--json"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        while process.poll() is None and len(list(runs.glob("*/tests.jsonl"))) < 2:
            time.sleep(0.01)
        down()
        gone = time.monotonic()
        while process.poll() is None and time.monotonic() < gone + seconds:
            time.sleep(0.01)
        away_until_the_end = process.poll() is not None
        if back:
            up()
        out, errors = process.communicate()
        if not back:
            up()
        states = [json.loads(line)["state"] for line in out.splitlines()]
        problems = []
        if process.returncode != 0 or states != ["finished"] * 4:
            problems.append(f"the command ended with {process.returncode}, the seeds are {states}: {errors}")
        if "Traceback" in errors or "warning" not in errors:
            problems.append(f"the warnings are: {errors}")
        if back and away_until_the_end:
            problems.append(f"the experiment was over before the database was back: raise --steps, now {steps}")
        reindexed, checked = karolos("db", "reindex", *where), karolos("db", "check", *where)
        if reindexed.returncode or checked.returncode:
            problems.append(f"db reindex, db check: {reindexed}, {checked}")
        listed = karolos("runs", "list", "--json", *where).stdout.splitlines()
        rows = [row for row in map(json.loads, listed) if row["folder"].startswith(os.fspath(runs.resolve()))]
        if sorted((row["seed"], row["state"]) for row in rows) != [(seed, "finished") for seed in range(4)]:
            problems.append(f"the database holds {rows}")
        return problems


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--database", help="URL of a PostgreSQL database; default: SQLite")
    parser.add_argument("--seconds", type=float, default=4.0, help="how long the database is away")
    parser.add_argument("--steps", type=int, default=4000, help="of each run")
    parser.add_argument("--never-back", action="store_true", help="the database is back after the end only")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        runs = Path(temporary) / "runs"
        problems = outage(runs, options.database, options.seconds, steps=options.steps, back=not options.never_back)
    print("\n".join(problems) or "every seed finished, and the database agrees with the folders")
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main())
