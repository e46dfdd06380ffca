"""Makes karolos on Linux see what it would see on Windows or macOS: KAROLOS_AS=windows|macos PYTHONPATH=this_folder.

Python imports it at the start of every process, of workers and launched processes as well. Only the project's modules
(MINE) are deceived about names; the rules for open files (Windows) hold for the whole process.
Not imitated: ctypes.WinDLL, case, MAX_PATH, reserved names, Ctrl-C events, named pipes, OpenGL. `karolos.system` is the one
module that may ask for the system: it keeps the names of Linux and is told that it is on Windows.
"""

import builtins, os, sys, threading, types, warnings

AS = os.environ.get("KAROLOS_AS")
MINE = ("karolos", "karolos_cli")
ALLOWED = {"karolos.system"}
MODULES = {
    "windows": "fcntl resource pwd grp termios tty pty posix syslog crypt spwd readline curses",
    "macos": "msvcrt winreg _winapi",
}
NAMES = {
    "windows": {
        "os": "fork forkpty getuid geteuid getgid getegid getgroups getresuid nice sysconf sysconf_names confstr pathconf fpathconf "
        "sched_getaffinity sched_setaffinity sched_yield memfd_create killpg getpgid setpgid setsid getsid getpgrp wait wait3 wait4 waitid "
        "WNOHANG WIFSIGNALED WTERMSIG mkfifo mknod chown lchown fchown O_DIRECTORY O_CLOEXEC O_NONBLOCK O_SYNC O_DSYNC O_NOFOLLOW O_TMPFILE "
        "uname getloadavg statvfs fstatvfs posix_fallocate posix_fadvise posix_spawn pidfd_open openpty register_at_fork ctermid pread pwrite "
        "readv writev sendfile fdatasync sync getpriority setpriority umask_ eventfd copy_file_range splice getxattr setxattr listxattr initgroups lockf",
        "signal": "SIGHUP SIGUSR1 SIGUSR2 SIGALRM SIGKILL SIGSTOP SIGCONT SIGCHLD SIGPIPE SIGQUIT SIGTSTP SIGTTIN SIGTTOU SIGWINCH setitimer "
        "getitimer ITIMER_REAL ITIMER_PROF ITIMER_VIRTUAL alarm pause pthread_kill pthread_sigmask sigwait sigpending siginterrupt SIG_BLOCK",
        "select": "poll POLLIN POLLOUT POLLHUP POLLERR epoll EPOLLIN kqueue",
        "time": "clock_gettime clock_gettime_ns pthread_getcpuclockid tzset CLOCK_MONOTONIC CLOCK_PROCESS_CPUTIME_ID",
        "socket": "AF_UNIX SO_REUSEPORT socketpair_",
        "multiprocessing.context": "ForkServerProcess ForkProcess ForkServerContext ForkContext",
        "multiprocessing": "",
        "mmap": "MAP_SHARED MAP_PRIVATE PROT_READ PROT_WRITE",
        "multiprocessing.reduction": "send_handle recv_handle sendfds recvfds",  # on Windows they are of handles, not of descriptors
    },
    "macos": {
        "os": "sched_getaffinity sched_setaffinity memfd_create fdatasync pidfd_open posix_fallocate posix_fadvise O_TMPFILE getrandom "
        "copy_file_range splice eventfd getxattr setxattr listxattr removexattr",
        "select": "epoll EPOLLIN",
        "signal": "SIGRTMIN SIGRTMAX sigtimedwait sigwaitinfo SIGPWR SIGSTKFLT SIGPOLL",
        "socket": "SO_BINDTODEVICE AF_PACKET AF_NETLINK",
    },
}


def _install() -> None:
    real_import = builtins.__import__
    missing, hidden = set(MODULES[AS].split()), {name: set(names.split()) for name, names in NAMES[AS].items()}
    proxies: dict[str, types.ModuleType] = {}
    replaced = {**(_windows() if AS == "windows" else {})}

    class Proxy(types.ModuleType):
        def __init__(self, name: str, module: types.ModuleType) -> None:
            super().__init__(name)
            self.__dict__.update(__deceived=module, __file__=getattr(module, "__file__", None))

        def __getattr__(self, name: str):
            own = self.__dict__["__deceived"]
            if name in hidden.get(self.__name__, ()):
                raise AttributeError(f"module {self.__name__!r} has no attribute {name!r} (on {AS})")
            if (self.__name__, name) in replaced:
                return replaced[self.__name__, name]
            return getattr(own, name)

        def __setattr__(self, name: str, value) -> None:  # monkeypatch
            setattr(self.__dict__["__deceived"], name, value)

        def __dir__(self):
            return [name for name in dir(self.__dict__["__deceived"]) if name not in hidden.get(self.__name__, ())]

    def mine(name: str | None) -> bool:
        return name is not None and name.partition(".")[0] in MINE and name not in ALLOWED

    def proxied(name: str):
        if name not in proxies:
            real_import(name)
            proxies[name] = Proxy(name, sys.modules[name])
        return proxies[name]

    def deceiving(name, globals=None, locals=None, fromlist=(), level=0):
        importer = (globals or {}).get("__name__")
        if importer == "__main__":
            importer = getattr((globals or {}).get("__spec__"), "name", None)
        if level == 0 and mine(importer):
            if name.partition(".")[0] in missing:
                raise ModuleNotFoundError(f"No module named {name!r} (on {AS})", name=name)
            module = real_import(name, globals, locals, fromlist, level)
            if name in hidden and (fromlist or "." not in name):
                if fromlist and name == "multiprocessing" and "reduction" in fromlist:
                    _told()
                    return _Both(proxied(name), reduction=proxied("multiprocessing.reduction"))
                return proxied(name)
            return module
        module = real_import(name, globals, locals, fromlist, level)
        _told()
        return module

    class _Both:
        def __init__(self, first, **own):
            self.__dict__.update(own, _first=first)

        def __getattr__(self, name):
            return getattr(self.__dict__["_first"], name)

    def _told() -> None:
        system = sys.modules.get("karolos.system")
        if AS == "macos" and system is not None:
            system.LINUX, system.MACOS = False, True
        known = system is not None and not getattr(system, "_told", False) and hasattr(system, "detached")
        if AS == "windows" and known:
            system.BINARY = 1 << 30
            system._told = system.WINDOWS = True
            system.LINUX = False
            system.own_group = system.detached = lambda: {}
            system.lower_priority = lambda niceness: None

    builtins.__import__ = deceiving
    if sys.flags.warn_default_encoding:
        for module in MINE:
            warnings.filterwarnings("error", category=EncodingWarning, module=rf"{module}(\.|$)")


def _windows():
    """Behaviour of Windows. Returns replacements for the project's modules; what pathlib and shutil use is replaced for all."""
    import errno, io, multiprocessing, select, socket, stat

    real = {
        name: getattr(os, name)
        for name in ("open", "write", "read", "close", "replace", "rename", "unlink", "remove", "kill")
    }
    text: set[int] = set()
    O_BINARY = 1 << 30

    deceived: dict[str, bool] = {}
    """Whether a process imitates Windows, too: no other one opens files of ours."""

    def is_deceived(process: str) -> bool:
        if process not in deceived:
            try:
                with io.open_code(f"/proc/{process}/environ") as file:
                    deceived[process] = b"KAROLOS_AS=windows" in file.read()
            except OSError:
                return False
        return deceived[process]

    def held(path: str, below: bool) -> str | None:
        """A process that has this file, or one below this folder, open."""
        end = path + os.sep
        for process in os.listdir("/proc"):
            if process.isdigit() and is_deceived(process):
                try:
                    for number in os.listdir(f"/proc/{process}/fd"):
                        try:
                            target = os.readlink(f"/proc/{process}/fd/{number}")
                            if target == path or (below and target.startswith(end)):
                                if stat.S_ISREG(os.stat(f"/proc/{process}/fd/{number}").st_mode):
                                    return f"{target} by process {process}"
                        except OSError:
                            continue
                except OSError:
                    continue
        return None

    def place(path, dir_fd=None) -> str:
        path = os.fspath(path)
        path = path.decode() if isinstance(path, bytes) else path
        base = os.readlink(f"/proc/self/fd/{dir_fd}") if dir_fd is not None else os.getcwd()
        folder, name = os.path.split(os.path.join(base, path))
        return os.path.join(os.path.realpath(folder), name)

    def refuse(path: str, below: bool = False) -> None:
        if who := held(path, below):
            raise PermissionError(errno.EACCES, f"The process cannot access the file because it is open: {who}", path)

    def move(how):
        def moved(source, target, *, src_dir_fd=None, dst_dir_fd=None):
            one, other = place(source, src_dir_fd), place(target, dst_dir_fd)
            if how == "rename" and one != other and os.path.lexists(other):
                raise FileExistsError(errno.EEXIST, "Cannot create a file when that file already exists", str(target))
            refuse(one, below=True)
            refuse(other)
            return real[how](source, target, src_dir_fd=src_dir_fd, dst_dir_fd=dst_dir_fd)

        return moved

    def unlink(path, *, dir_fd=None):
        refuse(place(path, dir_fd))
        return real["unlink"](path, dir_fd=dir_fd)

    os.replace, os.rename, os.unlink, os.remove = move("replace"), move("rename"), unlink, unlink

    def opened(path, flags, mode=0o777, *, dir_fd=None):
        if os.path.isdir(path):
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        number = real["open"](path, flags & ~O_BINARY, mode, dir_fd=dir_fd)
        text.discard(number) if flags & O_BINARY else text.add(number)
        return number

    def write(number, data):
        if number in text:
            real["write"](number, bytes(data).replace(b"\n", b"\r\n"))
            return len(data)
        return real["write"](number, data)

    def kill(process, number):
        if number in (0, 1):
            raise OSError(errno.EINVAL, "os.kill(process, 0) sends Ctrl-C on Windows")
        return real["kill"](process, 9)

    def get_context(method=None):
        if method in ("fork", "forkserver"):
            raise ValueError(f"cannot find context for {method!r}")
        return multiprocessing.get_context(method or "spawn")

    def waits(reading, writing, failing, timeout=None):
        if any(isinstance(one, int) or not isinstance(one, socket.socket) for one in (*reading, *writing, *failing)):
            raise OSError(10038, "An operation was attempted on something that is not a socket")
        return select.select(reading, writing, failing, timeout)

    import atexit, mmap

    def mapped(number, size, tagname=None, **more):
        if tagname is None:
            return mmap.mmap(number, size, **more)
        path = f"/dev/shm/{tagname}"  # memory with a name, which every process can map
        descriptor = real["open"](path, os.O_RDWR | os.O_CREAT, 0o600)
        try:
            if os.fstat(descriptor).st_size == 0:
                os.ftruncate(descriptor, size)
                atexit.register(lambda: os.path.exists(path) and real["unlink"](path))
            return mmap.mmap(descriptor, size, **more)
        finally:
            os.close(descriptor)

    import subprocess

    subprocess.Popen.terminate = subprocess.Popen.kill  # TerminateProcess
    return {
        ("os", "open"): opened,
        ("os", "write"): write,
        ("os", "kill"): kill,
        ("os", "O_BINARY"): O_BINARY,
        ("os", "name"): "nt",
        ("multiprocessing", "get_context"): get_context,
        ("multiprocessing", "get_all_start_methods"): lambda: ["spawn"],
        ("select", "select"): waits,
        ("mmap", "mmap"): mapped,
    }


if AS:
    _install()
