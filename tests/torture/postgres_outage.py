"""Kill and restart the PostgreSQL server that many runs write to at the same time.

    python tests/torture/postgres_outage.py [--runs 16] [--seconds 10] [--steps 2000]

Each run is a command of its own, which writes the index itself. The server (.ci/postgres) is killed when every run has
tested, and started again after some seconds. Every command has to end with 0 and a finished run. `karolos db reindex`
enters the tests of the outage, and `karolos db check` then says nothing. Ends with 1 if something differs.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
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


def karolos(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "karolos_cli", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


def start(folder: Path) -> str:
    """The URL of a new server."""
    made = subprocess.run([ROOT / ".ci" / "postgres", folder], capture_output=True, text=True, check=True)
    return made.stdout.strip()


def kill(folder: Path) -> None:
    os.kill(int((folder / "data" / "postmaster.pid").read_text().split()[0]), signal.SIGQUIT)  # at once, as in a crash


def restart(folder: Path) -> None:
    options = (folder / "data" / "postmaster.opts").read_text().split(maxsplit=1)
    server, arguments = options[0], options[1].replace('"', "").split()
    user = ["runuser", "-u", "postgres", "--"] if os.getuid() == 0 else []
    with (folder.parent / "again.log").open("w") as log:
        subprocess.Popen([*user, server, *arguments], cwd=folder, stdout=log, stderr=log, start_new_session=True)


def outage(home: Path, runs: int, seconds: float, steps: int) -> list[str]:
    """What differs from what is promised."""
    home.chmod(0o755)
    spec, folder, server = home / "outage.yaml", home / "runs", home / "postgres"
    spec.write_text(SPEC.replace("STEPS", str(steps)))
    where = ("--runs", str(folder), "--database", start(server))
    command = [sys.executable, "-m", "karolos_cli", "run", str(spec), *where]
    commands = [
        subprocess.Popen([*command, f"seeds=[{seed}]", "--quiet"], stderr=subprocess.PIPE, text=True)
        for seed in range(runs)
    ]
    try:
        while len(list(folder.glob("*/tests.jsonl"))) < runs and all(one.poll() is None for one in commands):
            time.sleep(0.05)
        early = sum(one.poll() is not None for one in commands)
        kill(server)
        time.sleep(seconds)
        late = sum(one.poll() is None for one in commands)
        restart(server)
        errors = [one.communicate()[1] for one in commands]
    finally:
        for one in commands:
            one.kill()
    warned = sum("warning" in error for error in errors)
    print(f"{early} runs had ended before the outage, {warned} warned, {late} went on when the server was back")
    problems = [f"seed {seed}: {error}" for seed, error in enumerate(errors) if "Traceback" in error]
    if codes := [one.returncode for one in commands if one.returncode]:
        problems.append(f"commands ended with {codes}: {errors}")
    if not late or not warned:
        problems.append("the outage hit no run: change --steps")
    before = karolos("db", "check", *where)
    print(f"db check before db reindex: {len(before.stdout.splitlines())} lines")
    for one in (karolos("db", "reindex", *where), karolos("db", "check", *where)):
        if one.returncode or one.stdout.strip():
            problems.append(f"{one.args}: {one.stdout}{one.stderr}")
    rows = [json.loads(line) for line in karolos("runs", "list", "--json", *where).stdout.splitlines()]
    if sorted((row["seed"], row["state"]) for row in rows) != [(seed, "finished") for seed in range(runs)]:
        problems.append(f"the database holds {rows}")
    kill(server)
    return problems


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=16)
    parser.add_argument("--seconds", type=float, default=10.0, help="how long the server is gone")
    parser.add_argument("--steps", type=int, default=2000, help="of each run")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        problems = outage(Path(temporary), options.runs, options.seconds, options.steps)
    print("\n".join(problems) or "every run finished, and the database agrees with the folders")
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main())
