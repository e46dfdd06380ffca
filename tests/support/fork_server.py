"""Starts commands of tests as forks of a server that has imported torch and karolos, within a tenth of a second.

Such a process has arguments, an environment, a folder, files and an id of its own, and who starts it waits for it as
for any child. What it starts itself forks from a server of its own. What is not among `MODULES` or marked by `FORKS`,
and everything on another system than Linux, starts as usual; so does everything in a test that uses the fixture
`real_processes`, and with `REAL_PROCESSES=1 pytest`.
"""

from __future__ import annotations

import ctypes
import gc
import importlib
import inspect
import json
import os
import random
import runpy
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from multiprocessing import util
from pathlib import Path
from threading import Lock
from typing import Any

MODULES = ("karolos.experiment.process", "karolos_cli", "karolos.export.simulated_robot")
"""Commands: `python -m MODULE`."""
FORKS = "# forks\n"
"""First line of code of a test: `python -c CODE` or `python FILE`."""
CODE = (FORKS, "from multiprocessing.spawn import", "from multiprocessing.forkserver import")
"""Beginnings of code that forks: marked, or of multiprocessing."""
AT_IMPORT = ("PYTHON", "OMP_NUM_THREADS", "KAROLOS_CACHE", "NUMBA_", "LD_")
"""Beginnings of the names of variables that count when Python and its libraries begin."""
PR_SET_CHILD_SUBREAPER = 36
"""Of <linux/prctl.h>."""
ROOT = Path(__file__).parents[2]


class ForkServer:
    """The server, which starts with the first command."""

    def __init__(self) -> None:
        self._lock = Lock()
        self.connection: socket.socket | None = None
        self.environment: dict[str, str] = {}
        """At the start of the session."""
        self.process: subprocess.Popen[bytes] | None = None

    def starts(self, words: Sequence[str], environment: Mapping[str, str], cwd: str = ".") -> bool:
        """Whether it can start this command line in a folder."""
        executable, *rest = words
        rest = rest[1:] if rest[:1] == ["-P"] else rest
        if executable != sys.executable or not rest or at_import(environment) != at_import(self.environment):
            return False
        if rest[0].startswith("-"):
            return rest[1] in MODULES if rest[0] == "-m" else rest[0] == "-c" and rest[1].startswith(CODE)
        script = Path(cwd, rest[0])
        return script.is_file() and script.read_bytes().startswith(FORKS.encode())

    def start(self, words: Sequence[str], files: Mapping[int, int], **how: Any) -> int:
        """Start a command as a child of this process; its id.

        Args:
            words: its command line.
            files: its file descriptors, and ours that they are.
            how: the rest of what `_become` reads.
        """
        with self._lock:
            connection = self.connection = self.connection or self._connect()
            message = {"words": words, "numbers": list(files), "cwd": os.getcwd()} | how
            adopt(True)  # the process that forks the command ends at once, and we are next
            try:
                socket.send_fds(connection, [json.dumps(message).encode()], list(files.values()))
                answer = connection.recv(8)
            finally:
                adopt(False)
        assert answer, "the server has ended"
        return int.from_bytes(answer, "little")

    def _connect(self) -> socket.socket:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        code = f"import sys; base = sys.path[1:]; sys.path += {[str(ROOT / 'tests'), *sys.path]}\n"
        code += f"from support import fork_server; fork_server.execute(*fork_server.serve({theirs.fileno()}, base))"
        files = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "pass_fds": [theirs.fileno()]}
        self.process = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, env=self.environment, **files)
        theirs.close()
        assert ours.recv(8) == b"ready"
        return ours

    def close(self) -> None:
        if self.connection is not None and self.process is not None:
            self.connection.close()
            self.process.wait()


SERVER = ForkServer()


def at_import(environment: Mapping[str, str]) -> dict[str, str]:
    """The variables that a forked process cannot change."""
    return {name: value for name, value in environment.items() if name.startswith(AT_IMPORT) and name != "PYTHONPATH"}


def adopt(on: bool) -> None:
    """Whether this process becomes the parent of descendants whose parents end."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, int(on), 0, 0, 0)


def install(patch: Callable[[object, str, object], None]) -> None:
    """Let `subprocess` and `multiprocessing` start commands through the server. `patch`: as `setattr`."""
    if sys.platform != "linux" or "REAL_PROCESSES" in os.environ:
        return
    SERVER.environment = SERVER.environment or dict(os.environ)
    start, spawn = subprocess.Popen._execute_child, util.spawnv_passfds
    names = list(inspect.signature(start).parameters)

    def execute_child(popen: subprocess.Popen[Any], *given: Any) -> None:
        one = dict(zip(names, (popen, *given), strict=True))
        unusual = any(one[name] for name in ("shell", "preexec_fn", "executable")) or one["umask"] != -1
        words = [one["args"]] if isinstance(one["args"], str | bytes) else [os.fsdecode(word) for word in one["args"]]
        variables = os.environ if one["env"] is None else one["env"]
        environment = {os.fsdecode(name): os.fsdecode(value) for name, value in variables.items()}
        cwd = os.path.abspath(one["cwd"] or ".")
        if unusual or not SERVER.starts(words, environment, cwd):
            start(popen, *given)
            return
        pipes = {0: one["p2cread"], 1: one["c2pwrite"], 2: one["errwrite"]}
        files = {number: number if ours == -1 else ours for number, ours in pipes.items()}
        popen.pid = SERVER.start(
            words,
            files | {number: number for number in one["pass_fds"]},
            environment=environment,
            session=one["start_new_session"],
            group=one["process_group"],
            cwd=cwd,
        )
        popen._child_created = True
        popen._close_pipe_fds(*(one[f"{pipe}{end}"] for pipe in ("p2c", "c2p", "err") for end in ("read", "write")))

    def spawnv_passfds(path: bytes, words: Sequence[str | bytes], numbers: Sequence[int]) -> int:
        texts = [os.fsdecode(path), *map(os.fsdecode, words[1:])]
        if not SERVER.starts(texts, os.environ):
            return spawn(path, words, numbers)
        files = {number: number for number in (0, 1, 2, *numbers)}
        return SERVER.start(texts, files, environment=dict(os.environ), session=False, group=-1)

    patch(subprocess.Popen, "_execute_child", execute_child)
    patch(util, "spawnv_passfds", spawnv_passfds)


# In the server


def serve(number: int, path: list[str]) -> tuple[list[str], list[str]]:
    """Fork a process for each message of the connection. Returns in that process, with what `execute` takes.

    Args:
        number: file descriptor of the connection.
        path: Python's path at the start.
    """
    for name in ("torch", "karolos_cli.main", *MODULES, "karolos.plans.sweep", "support.preloaded"):
        with suppress(ImportError):  # a later Python has no torch here
            importlib.import_module(name)
    named = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    base = [folder for folder in path if folder not in named]
    gc.freeze()
    ctypes.CDLL(None).fflush(None)  # what libraries print when they are imported
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in a terminal reaches all
    connection = socket.socket(fileno=number)
    connection.send(b"ready")
    while True:
        message, files, _, _ = socket.recv_fds(connection, 2**18, 64)
        if not message:
            os._exit(0)
        wait, go = os.pipe()
        tell, told = os.pipe()
        between = os.fork()
        if between == 0:
            if os.fork():
                os._exit(0)
            how = json.loads(message)
            if how["session"]:
                os.setsid()
            elif how["group"] >= 0:
                os.setpgid(0, how["group"])
            os.write(told, os.getpid().to_bytes(8, "little"))
            os.close(go)
            os.read(wait, 1)  # until its parent is who asked for it
            ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            if os.fork():
                return _become(how, files, base, ours)
            ours.close()
            connection.close()
            connection = theirs  # of the server for what this command starts
        else:
            os.waitpid(between, 0)
            connection.send(os.read(tell, 8))
            os.close(go)
        for file in (*files, wait, tell, told):
            os.close(file)


def _become(
    message: dict[str, Any], files: list[int], base: list[str], server: socket.socket
) -> tuple[list[str], list[str]]:
    """Make this process what a command line would start.

    Args:
        message: the command's words, environment and folder, and the numbers of its files.
        files: received file descriptors.
        base: folders of Python's path that no variable names.
        server: connection to a server of its own.
    """
    import fcntl

    above = max(64, *message["numbers"]) + 1
    received = [fcntl.fcntl(file, fcntl.F_DUPFD, above) for file in files]
    kept = fcntl.fcntl(server.detach(), fcntl.F_DUPFD_CLOEXEC, above)
    os.closerange(3, above)
    for file, number in zip(received, message["numbers"], strict=True):
        os.dup2(file, number)
    for file in received:
        os.close(file)
    SERVER.connection, SERVER.environment = socket.socket(fileno=kept), dict(os.environ)
    install(setattr)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.chdir(message["cwd"])
    os.environ.clear()
    os.environ.update(message["environment"])
    random.seed()
    importlib.invalidate_caches()
    words = message["words"]
    first = {"-P": [], "-m": [message["cwd"]], "-c": [""]}.get(words[1], [str(Path(message["cwd"], words[1]).parent)])
    return words, [*first, *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep)), *base]


def execute(words: list[str], path: list[str]) -> None:
    """Do what `python` does with these words. The process ends with this call."""
    sys.path[:] = path
    option, *arguments = words[2:] if words[1] == "-P" else words[1:]
    if not option.startswith("-"):
        sys.argv[:] = [option, *arguments]
        runpy.run_path(option, run_name="__main__")
        return
    what, *arguments = arguments
    sys.argv[:] = [option, *arguments]
    if option == "-m":
        sys.modules.pop(what, None)
        runpy.run_module(what, run_name="__main__", alter_sys=True)
    else:
        exec(compile(what, "<string>", "exec"), sys.modules["__main__"].__dict__)
