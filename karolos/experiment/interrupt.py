"""Ctrl-C while a command imports its libraries. Imports next to nothing itself."""

import os
import signal
import threading


class BriefInterrupt:
    """While it is entered, Ctrl-C is one line and exit code 130: an import could turn it into another error."""

    def __enter__(self) -> None:
        usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # nohup ignores it
        self._handles = usual and threading.current_thread() is threading.main_thread()
        if self._handles:
            signal.signal(signal.SIGINT, _end)

    def __exit__(self, *_: object) -> None:
        if self._handles:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def _end(*_: object) -> None:
    os.write(2, b"interrupted\n")
    os._exit(128 + signal.SIGINT)
