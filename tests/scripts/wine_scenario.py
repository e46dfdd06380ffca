"""What a user does on Windows, by Windows' CPython under Wine: `wine_scenario.py ROOT`. Prints a log; exit code 1 if a
step fails. Episodes are compared with those of this Linux, whose `karolos` is on the PATH."""

from __future__ import annotations

import json
import os
import pty
import re
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path

ROOT = Path(sys.argv[1])
WORK = ROOT / "work"
SECONDS = 400
NOISE = re.compile(r"XDG_RUNTIME|cpuinfo|^\s*$")
SPECS = ("panda_reach", "ur5_push", "iiwa_reach")
failed = []


def wine(*words: str) -> list[str]:
    hidden = "WINEDLLOVERRIDES=winedbg.exe=;mscoree=;mshtml="
    environment = ["HOME=/root", "PATH=/usr/bin:/bin", "WINEPREFIX=/root/wp", "WINEDEBUG=-all", hidden]
    inner = 'cd /work; exec /usr/lib/wine/wine64 Z:/py/python.exe "$@"'
    return ["chroot", str(ROOT), "/usr/bin/env", "-i", *environment, "sh", "-c", inner, "sh", *words]


def karolos(*words: str, expected: int = 0) -> str:
    print(f"\n> karolos {' '.join(words)}", flush=True)
    started = time.monotonic()
    with tempfile.TemporaryFile() as told:  # a pipe would stay open as long as a detached run holds it
        done = subprocess.run(
            wine("-m", "karolos_cli", *words),
            stdin=subprocess.DEVNULL,
            stdout=told,
            stderr=subprocess.STDOUT,
            timeout=SECONDS,
            check=False,
        )
        told.seek(0)
        text = told.read().decode("utf-8", "replace")
    lines = [line.rstrip() for line in text.splitlines() if not NOISE.search(line)]
    print("\n".join(lines[-8:]))
    print(f"exit code {done.returncode}, {time.monotonic() - started:.0f} s", flush=True)
    if done.returncode != expected:
        failed.append(" ".join(words))
    return text


def run_of(runs: str, name: str, seed: int = 0) -> Path:
    return max((WORK / runs).glob(f"*{name}-s{seed}-*"))


def agreed(what: str, one: object, other: object) -> None:
    print(f"{what}: {'equal' if one == other else 'DIFFERENT'}", flush=True)
    if one != other:
        failed.append(what)


def policy(run: Path) -> object:
    """The hash of the policy that the final test played."""
    return json.loads((run / "final.jsonl").read_text("utf-8").splitlines()[0])["sha256"]


def compare_with_linux() -> None:
    for name in SPECS:
        spec = f"karolos:smoke/{name}"
        karolos("run", spec, "orchestrator.processes=2", "--runs", "r", "--quiet")
        here = ["karolos", "run", spec, "orchestrator.processes=2", "--runs", str(WORK / "linux"), "--quiet"]
        subprocess.run(here, check=True, stderr=subprocess.DEVNULL)
        pair = [(run_of(runs, name) / "episodes.jsonl").read_bytes() for runs in ("r", "linux")]
        agreed(f"training episodes of {name} there and on Linux", *pair)


def stop_and_resume() -> None:
    """Ctrl-C in a terminal, and `resume`."""
    spec = ("karolos:smoke/panda_reach", "training.steps=3000", "testing.interval=1000")
    karolos("run", *spec, "--runs", "whole", "--quiet")
    print(f"\n> karolos run {' '.join(spec)} --runs stopped      (Ctrl-C after some episodes)", flush=True)
    process, terminal = pty.fork()
    if process == 0:
        os.execvp("chroot", wine("-m", "karolos_cli", "run", *spec, "--runs", "stopped"))
    wait_for(lambda: any(path.stat().st_size for path in (WORK / "stopped").glob("*/episodes.jsonl")), terminal)
    os.write(terminal, b"\x03")
    wait_for(
        lambda: any('"stopped"' in path.read_text("utf-8") for path in (WORK / "stopped").glob("*/state.json")),
        terminal,
    )
    end = time.monotonic() + 30
    while time.monotonic() < end and os.waitpid(process, os.WNOHANG)[0] == 0:
        read(terminal)
        time.sleep(0.2)
    run = run_of("stopped", "panda_reach")
    print((run / "state.json").read_text("utf-8"))
    karolos("resume", run.name, "--runs", "stopped", "--quiet")
    whole = run_of("whole", "panda_reach")
    agreed("policy of the stopped and resumed run, and of one without a stop", policy(run), policy(whole))


def detach_and_stop() -> None:
    """A run without a terminal, which another command stops."""
    karolos("run", "karolos:smoke/panda_reach", "training.steps=30000", "--detach", "--runs", "d")
    states = (WORK / "d").glob
    end = time.monotonic() + SECONDS
    while all('"created"' in path.read_text("utf-8") for path in states("*/state.json")) and time.monotonic() < end:
        time.sleep(0.5)
    run = run_of("d", "panda_reach")
    karolos("runs", "stop", run.name, "--runs", "d")
    end = time.monotonic() + 60
    while '"stopped"' not in (run / "state.json").read_text("utf-8") and time.monotonic() < end:
        time.sleep(0.5)
    agreed("a detached run is stopped", json.loads((run / "state.json").read_text("utf-8"))["state"], "stopped")


def wait_for(condition: Callable[[], bool], terminal: int) -> None:
    end = time.monotonic() + SECONDS
    while not condition() and time.monotonic() < end:
        read(terminal)
        time.sleep(0.1)


def read(terminal: int) -> None:
    while select.select([terminal], [], [], 0)[0]:
        try:
            if not os.read(terminal, 65536):
                return
        except OSError:
            return


def page() -> None:
    print("\n> karolos ui --runs r --port 8765", flush=True)
    command = wine("-m", "karolos_cli", "ui", "--runs", "r", "--port", "8765")
    server = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    text, end = "", time.monotonic() + 120
    while not text and time.monotonic() < end:
        try:
            text = urllib.request.urlopen("http://127.0.0.1:8765/", timeout=30).read().decode()
        except OSError:
            time.sleep(1)
    agreed("the page names a run", "smoke_panda_reach" in text, True)
    karolos("ui", "--runs", "r", "--port", "8765", expected=3)
    server.send_signal(signal.SIGTERM)
    server.wait(30)


def main() -> None:
    shutil.rmtree(WORK, ignore_errors=True)
    WORK.mkdir()
    karolos("--version")
    karolos("--help")
    karolos("spec", "list")
    compare_with_linux()
    karolos("run", "karolos:smoke/toy", "seeds=[0,1]", "--jobs", "2", "--runs", "r2", "--quiet")
    karolos("runs", "list", "--runs", "r2")
    stop_and_resume()
    detach_and_stop()
    run = run_of("r", "panda_reach").name
    karolos("test", run, "--runs", "r", "task.threshold=0.1")
    karolos("compare", "smoke_panda_reach", "--runs", "r", "--out", "comparison.html")
    karolos("export", run, "--runs", "r")
    karolos("runs", "rm", run, "--runs", "r")
    karolos("runs", "restore", run, "--runs", "r")
    karolos("runs", "export", "runs.tar.gz", run, "--runs", "r")
    karolos("runs", "import", "runs.tar.gz", "--runs", "r3")
    page()
    print(f"\n{len(failed)} failed{': ' if failed else ''}{'; '.join(failed)}")
    sys.exit(bool(failed))


main()
