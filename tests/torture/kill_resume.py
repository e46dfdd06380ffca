"""Kill a run at random moments until it is finished, and see that nothing was lost: neither a test nor a bit.

    python tests/torture/kill_resume.py --kills 100 [--spec SPEC] [--seed 0] [--runs DIR]

A run is started, killed with SIGKILL after a random time, resumed, killed again ... Half of the kills hit a worker of
the run, which goes on. The times are drawn so that kills fall into training, testing, checkpoints and index writes
alike; a third of the kills wait for the next checkpoint to be amid its writing. After a kill of the run, every process
that it had started has to end by itself. When a run has finished another one begins, until the kills are done. Each
finished run is compared with one that nobody disturbed: weights, buffer, counters and generators of the last
checkpoint, tests, training episodes, and what the database says. Ends with 1 at the first difference.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from karolos.plugins.contracts.case import state_differences
from karolos.records import RunFolder, checkpoint
from karolos.store import Store, query

PATIENCE = 15.0
"""Seconds that a killed run's workers have to notice and to end."""
AMID_CHECKPOINT = 1 / 3
"""Share of the kills that hit the writing of a checkpoint."""
TOY = """
name: torture
environment: toy
agent: {name: sac, hidden: [16], precision: float32}
buffer: {name: priority, capacity: 2000, hindsight: {strategy: future}}
orchestrator: {processes: 2, environments: 2, failures: 1000}
training: {steps: 1600, batch_size: 16, replay_ratio: 8, warmup_episodes: 4}
testing: {interval: 50, episodes: 4}
"""


def karolos(*arguments: str) -> subprocess.Popen[bytes]:
    """The command in a process group of its own, so that a kill reaches the parent alone and orphans can be seen."""
    return subprocess.Popen(
        [sys.executable, "-m", "karolos_cli", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


def over(process: subprocess.Popen[bytes], seconds: float, home: Path | None = None) -> bool:
    """Wait; returns whether the process has ended.

    Args:
        process: as `karolos` started it.
        seconds: to wait.
        home: wait further, until a run in this folder is amid writing a checkpoint.
    """
    deadline = time.monotonic() + seconds
    while process.poll() is None:
        if time.monotonic() > deadline and (home is None or any(home.glob("*/checkpoints/.*.new"))):
            return False
        time.sleep(0.001)
    return True


def kill_worker(process: subprocess.Popen[bytes], draw: random.Random) -> bool:
    """Kill one of the run's workers, which are grandchildren of its process; False if there is none now."""
    workers = [pid for pid, (_, parent) in members(process.pid).items() if process.pid not in (pid, parent)]
    if not workers or process.poll() is not None:
        return False
    with suppress(ProcessLookupError):
        os.kill(draw.choice(workers), signal.SIGKILL)
        return True
    return False


def await_the_end_of_the_others(session: int) -> None:
    """Raise SystemExit when processes of the session outlive its first for long; only Linux can tell."""
    deadline = time.monotonic() + PATIENCE
    while left := members(session):
        if time.monotonic() > deadline:
            raise SystemExit(f"orphans after a kill: {left}")
        time.sleep(0.05)


def members(session: int) -> dict[int, tuple[str, int]]:
    """The living processes of a session, with their command lines and parents."""
    found = {}
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended meanwhile
            state, parent, _, its_session = (path / "stat").read_text().rpartition(")")[2].split()[:4]
            if int(its_session) == session and state != "Z":
                found[int(path.name)] = (path / "cmdline").read_bytes().replace(b"\0", b" ").decode(), int(parent)
    return found


def torture(spec: Path, runs: Path, kills: int, draw: random.Random) -> int:
    """Returns how many finished runs were compared; raises SystemExit at a difference."""
    started = time.monotonic()
    undisturbed = karolos("run", str(spec), "--runs", str(runs / "reference"), "--quiet")
    assert undisturbed.stderr is not None
    errors = undisturbed.stderr.read().decode()
    if undisturbed.wait() != 0:
        raise SystemExit(f"the undisturbed run failed: {errors}")
    whole = time.monotonic() - started
    print(f"an undisturbed run takes {whole:.1f} s", flush=True)
    (reference,) = (RunFolder.open(path.parent) for path in (runs / "reference").glob("*/run.json"))
    done = compared = hits = 0
    while done < kills:
        home = runs / f"killed-{compared}"
        database = Store.default_url(home)
        code: int | None = None
        while code is None:
            folders = [path.parent for path in home.glob("*/run.json")]
            arguments = ("resume", str(folders[0])) if folders else ("run", str(spec))
            process, began = karolos(*arguments, "--runs", str(home), "--quiet"), time.monotonic()
            while True:
                amid_checkpoint = draw.random() < AMID_CHECKPOINT and done < kills
                patience = draw.uniform(0.1, 0.9) * whole if done < kills else 600.0
                if over(process, patience, home if amid_checkpoint else None):
                    code = process.returncode
                    whole = (whole + time.monotonic() - began) / 2  # the machine may have become faster
                    break
                if 2 * hits < done + 1:
                    hit = kill_worker(process, draw)
                    done, hits = done + hit, hits + hit
                    continue
                os.kill(process.pid, signal.SIGKILL)
                process.wait()
                await_the_end_of_the_others(process.pid)
                done += 1
                break
        assert process.stderr is not None
        errors = process.stderr.read().decode()
        if code != 0:
            raise SystemExit(f"after {done} kills, {' '.join(arguments)} ended with {code}: {errors}")
        folder = next(RunFolder.open(path.parent) for path in home.glob("*/run.json"))
        found = differences_of(folder, reference, database)
        compared += 1
        print(
            f"{done} kills, {hits} of workers, run {compared} in attempt {folder.state().attempt}: {found or 'equal'}",
            flush=True,
        )
        if found:
            raise SystemExit(1)
    return compared


def differences_of(folder: RunFolder, reference: RunFolder, database: str) -> list[str]:
    """Differences between a run and an undisturbed one of the same spec and seed, except the seconds they took.

    Args:
        folder: of the run.
        reference: folder of the undisturbed run.
        database: URL of the index that holds the run.
    """
    one, other = (checkpoint.load(run.checkpoints, "last")[0] for run in (folder, reference))
    found = state_differences(one, other, ignore=frozenset({"seconds"}), path="last")
    tests = [(test.steps, test.any, test.end, test.returns) for test in folder.tests()]
    if tests != [(test.steps, test.any, test.end, test.returns) for test in reference.tests()]:
        found.append("tests.jsonl")
    if (folder.path / "episodes.jsonl").read_text() != (reference.path / "episodes.jsonl").read_text():
        found.append("episodes.jsonl")
    with Store(database) as store:
        record = store.records([query.find(store, folder.id)])[0]
        tests = [(test.steps, test.successes_any, test.successes_end) for test in record.tests]
        if tests != [(test.steps, sum(test.any), sum(test.end)) for test in folder.tests()]:
            found.append(f"tests in the database: {tests}")
        if query.find(store, folder.id) != folder.summary():
            found.append("the run's row in the database")
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--spec", type=Path, help="a small spec of one seed; default: the toy environment")
    parser.add_argument("--seed", type=int, default=0, help="of the times")
    parser.add_argument("--runs", type=Path, help="where the runs go; default: a temporary folder")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        runs = options.runs or Path(temporary)
        runs.mkdir(parents=True, exist_ok=True)
        spec = options.spec
        if spec is None:
            spec = runs / "torture.yaml"
            spec.write_text(TOY)
        compared = torture(spec, runs, options.kills, random.Random(options.seed))
    print(f"{options.kills} kills, {compared} runs, all equal to the undisturbed one")


if __name__ == "__main__":
    main()
