"""Kill and restart the PostgreSQL server that many runs write to at the same time; a long test.

Each run is a command of its own, which writes the index itself. The server (tests/scripts/postgres) is killed when each
run has tested, and started again after some seconds. Every command has to end with 0 and a finished run.
`karolos db reindex` enters the tests of the outage, and `karolos db check` then says nothing.
"""

import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from support.torture import TIMES, karolos
from support.toy_runs import toy

ROOT = Path(__file__).parents[1]
RUNS, SECONDS = 16, 10.0
"""Commands, and how long the server is gone."""


def asked(*arguments: str) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command."""
    command = karolos(*arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    out, err = command.communicate(timeout=300)
    return command.returncode, out, err


def start(folder: Path) -> str:
    """The URL of a new server."""
    made = subprocess.run([ROOT / "scripts" / "postgres", folder], capture_output=True, text=True, check=True)
    return made.stdout.strip()


def kill(folder: Path) -> None:
    os.kill(int((folder / "data" / "postmaster.pid").read_text().split()[0]), signal.SIGQUIT)  # at once, as in a crash


def restart(folder: Path) -> None:
    options = (folder / "data" / "postmaster.opts").read_text().split(maxsplit=1)
    server, arguments = options[0], options[1].replace('"', "").split()
    user = ["runuser", "-u", "postgres", "--"] if os.getuid() == 0 else []
    with (folder.parent / "again.log").open("w") as log:
        subprocess.Popen([*user, server, *arguments], cwd=folder, stdout=log, stderr=log, start_new_session=True)


@pytest.fixture
def home() -> Iterator[Path]:
    """A folder that the server's user may enter; the server in it is stopped at the end."""
    with TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        yield Path(folder)
        kill(Path(folder, "postgres"))


@pytest.mark.skipif(TIMES == 1, reason="a long test")
def test_runs_outlive_their_database_which_agrees_with_the_folders_afterwards(home):
    spec, folder, server = home / "outage.yaml", home / "runs", home / "postgres"
    spec.write_text(json.dumps(toy(training={"steps": 2000}, testing={"interval": 100, "episodes": 4})))
    where = ("--runs", str(folder), "--database", start(server))
    commands = [
        karolos("run", str(spec), *where, f"seeds=[{seed}]", "--quiet", stderr=subprocess.PIPE, text=True)
        for seed in range(RUNS)
    ]
    try:
        while len(list(folder.glob("*/tests.jsonl"))) < RUNS and all(one.poll() is None for one in commands):
            time.sleep(0.05)
        kill(server)
        time.sleep(SECONDS)
        assert any(one.poll() is None for one in commands), "the outage hit no run: more steps"
        restart(server)
        errors = [one.communicate()[1] for one in commands]
    finally:
        for one in commands:
            one.kill()
    assert not [error for error in errors if "Traceback" in error]
    assert [one.returncode for one in commands] == [0] * RUNS, errors
    assert any("warning" in error for error in errors)
    for command in ("reindex", "check"):
        code, out, err = asked("db", command, *where)
        assert (code, out.strip()) == (0, ""), err
    rows = [json.loads(line) for line in asked("runs", "list", "--json", *where)[1].splitlines()]
    assert sorted((row["seed"], row["state"]) for row in rows) == [(seed, "finished") for seed in range(RUNS)]
