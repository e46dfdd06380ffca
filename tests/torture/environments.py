"""Run environments that misbehave in every method, and see that each run ends in time, in one state and with a reason.

    python tests/torture/environments.py [--count 200] [--seed 0] [--seconds 120]

Each is `karolos check` and `karolos run` with a time limit, with and without worker processes. Exit code 0 goes with a
finished run only. Ends with 1 otherwise.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import random
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.hostile import KINDS, METHODS, spec

from karolos.records import RunFolder

LEAK_BYTES = 2 << 30
"""Address space of an environment that leaks memory, beyond which it fails."""


def call(home: Path, seconds: float, *arguments: str, limited: bool) -> tuple[int, str]:
    """Exit code and output of a command; 1000 if it does not end."""
    command = [sys.executable, "-m", "karolos_cli", *arguments]
    if limited:
        command = ["sh", "-c", f'ulimit -v {(LEAK_BYTES + (8 << 30)) >> 10}; exec "$@"', "run", *command]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        done = subprocess.run(
            command, cwd=home, env=environment, capture_output=True, text=True, timeout=seconds, check=False
        )
    except subprocess.TimeoutExpired:
        return 1000, ""
    return done.returncode, done.stdout + done.stderr


def problem_of(home: Path, trouble: str, processes: int, seconds: float) -> tuple[str, str]:
    """How the run ended, and what is wrong with that."""
    (home / "spec.yaml").write_text(json.dumps(spec(trouble, processes)))
    limited = trouble.endswith("leak")
    checked, said = call(home, seconds, "check", "spec.yaml", limited=limited)
    if checked not in (0, 2, 3, 130, 1000, -9) or (checked in (2, 3) and not said):
        return "", f"check ended with {checked}: {said[-300:]}"
    code, said = call(home, seconds, "run", "spec.yaml", "--time-limit", "3s", "--quiet", limited=limited)
    states = [RunFolder.open(path.parent).state().state for path in home.glob("runs/*/run.json")]
    ended = states[0] if states else f"refused ({code})"
    if code == 1000:
        return ended, "does not end"
    if (code == 0) != (states == ["finished"]):
        return ended, f"exit code {code} with {states}"
    if 0 < code < 124 and not said.strip():
        return ended, f"exit code {code} without a word"
    return ended, ""


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=120.0, help="in which a command has to end")
    options = parser.parse_args()
    cases = list(itertools.product(METHODS, KINDS, (0, 1)))
    random.Random(options.seed).shuffle(cases)
    problems, ends = [], Counter[str]()
    for method, kind, processes in cases[: options.count]:
        with tempfile.TemporaryDirectory() as home:
            ended, problem = problem_of(Path(home), f"{method}:{kind}", processes, options.seconds)
        ends[ended] += 1
        if problem:
            problems.append(f"{method}:{kind} with {processes} processes: {problem}")
            print(problems[-1], flush=True)
        if sum(ends.values()) % 10 == 0:
            print(f"{sum(ends.values())}: {dict(ends)}", flush=True)
    print(f"{sum(ends.values())} environments: {dict(ends)}; {len(problems)} problems")
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main())
