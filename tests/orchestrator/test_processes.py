"""Worker processes and the program that uses them: each test runs a program of its own, as a user would."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from support.processes import wait_until_gone

TESTS = Path(__file__).parents[1]
HEAD = f"""
import sys
sys.path.insert(0, {str(TESTS)!r})
import numpy as np
from functools import partial
from support.fake_environments import FINE, HANG, PRINT, Fake
from karolos.orchestrator import processes as start
from karolos.orchestrator.local import Local
MARK_OF_THE_USERS_SCRIPT = True

def make(processes=2, threads=1, environments=2):
    settings = Local.Settings(processes=processes, threads=threads, environments=environments)
    return Local(settings, partial(Fake, ""))

def step(orchestrator, trouble):
    orchestrator.step(range(orchestrator.size), np.full((orchestrator.size, 1), trouble, np.float32))
    return orchestrator.receive().step.observation

def pids(orchestrator):
    orchestrator.reset(range(orchestrator.size), range(orchestrator.size))
    return orchestrator.receive().step.observation[:, 0].astype(int).tolist()
"""


def start(folder: Path, body: str, *, first: str = "", **how: bool) -> subprocess.CompletedProcess[str]:
    """Run a program to its end."""
    script = folder / "program.py"
    script.write_text(first + HEAD + body)
    return subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=60, check=False, **how)


def run(folder: Path, body: str) -> str:
    """What a program prints. Fails with its standard error."""
    ended = start(folder, body)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


def test_workers_import_neither_torch_nor_the_users_script_and_change_nothing_of_the_program(tmp_path):
    """The script has no `if __name__ == "__main__"`, and stands for one that has imported torch."""
    output = run(
        tmp_path,
        """
import os, types
sys.modules["torch"] = types.ModuleType("torch")
for name in start.ONE_THREAD:
    os.environ.pop(name, None)
os.environ["OMP_NUM_THREADS"] = "3"
before = dict(os.environ)
print("the script runs")
with make() as orchestrator:
    pids(orchestrator)
    print(step(orchestrator, FINE)[:, 2:].tolist())
    step(orchestrator, PRINT)  # what workers print stays out of the program's output
print("main is back:", sys.modules["__main__"].MARK_OF_THE_USERS_SCRIPT)
print("the environment is as it was:", dict(os.environ) == before)
""",
    )
    torch, threads, main = 0.0, 1.0, 0.0
    seen = str([[torch, threads, main]] * 4)
    assert output.splitlines() == ["the script runs", seen, "main is back: True", "the environment is as it was: True"]


@pytest.mark.parametrize(
    ("first", "last", "error"),
    [
        ("", "", ""),
        # something else is the first to ask for clean-up at exit; it must not decide the order
        ("import weakref\nweakref.finalize(weakref.finalize, print)\n", "", ""),
        ("", "raise LookupError('mine')", "LookupError: mine"),
    ],
)
def test_a_program_that_never_closes_leaves_no_worker_and_shows_its_own_error_alone(tmp_path, first, last, error):
    ended = start(tmp_path, f"orchestrator = make()\nprint(*pids(orchestrator), flush=True)\n{last}", first=first)
    assert ended.returncode == bool(error)
    assert ended.stderr.strip().endswith(error)
    assert ended.stderr.count("Traceback") == bool(error)
    wait_until_gone(*map(int, ended.stdout.split()))


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="reads what is mapped from /proc")
def test_shared_memory_has_no_name_that_could_stay_behind(tmp_path):
    output = run(
        tmp_path,
        """
from pathlib import Path
with make() as orchestrator:
    for pid in ("self", *sorted(set(pids(orchestrator)))):
        maps = Path(f"/proc/{pid}/maps").read_text()
        print(maps.count("memfd:karolos"), maps.count("/dev/shm/"), maps.count("pym-"))
""",
    )
    assert output.splitlines() == ["1 0 0"] * 3


@pytest.mark.parametrize("trouble", ["FINE", "HANG"])
def test_a_program_that_is_killed_leaves_no_worker(tmp_path, trouble):
    body = f"""
import os, threading
orchestrator = make(processes=2, threads=2)
print(*pids(orchestrator), flush=True)
threading.Timer(0.3, os.kill, (os.getpid(), 9)).start()
while True:
    step(orchestrator, {trouble})
"""
    shared = Path("/dev/shm")
    before = set(shared.iterdir()) if shared.exists() else set()
    ended = start(tmp_path, body)
    assert ended.returncode == -signal.SIGKILL
    wait_until_gone(*map(int, ended.stdout.split()))
    left = (set(shared.iterdir()) if shared.exists() else set()) - before
    assert not [path for path in left if path.name.startswith(("psm_", "pym-", "karolos"))]


def test_a_signal_to_the_whole_group_is_the_parents_to_decide(tmp_path):
    """Ctrl-C and job schedulers signal every process; the parent finishes its step and may go on."""
    body = """
import os, signal
orchestrator = make()
before = pids(orchestrator)
for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGUSR1"):
    heard = []
    signal.signal(getattr(signal, name), lambda *_: heard.append(1))
    os.killpg(0, getattr(signal, name))
    step(orchestrator, FINE)
    print(name, bool(heard), pids(orchestrator) == before)
orchestrator.close()
"""
    ended = start(tmp_path, body, start_new_session=True)
    assert ended.stderr == ""
    assert ended.stdout == "".join(f"{name} True True\n" for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGUSR1"))
