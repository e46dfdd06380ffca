"""Handles Ctrl-C while a command imports its libraries, and SIGTERM if nothing else does. Imports almost nothing."""

import os
import signal
import threading


class BriefInterrupt:
    """Inside the block Ctrl-C gives one line and exit code 130. An import could turn it into another error."""

    def __enter__(self) -> None:
        usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # nohup ignores it
        self._handles = usual and threading.current_thread() is threading.main_thread()
        if self._handles:
            signal.signal(signal.SIGINT, end_at_once)

    def __exit__(self, *_: object) -> None:
        if self._handles:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def end_at_once(number: int, _: object) -> None:
    """A handler of signals that ends the process with a line and the exit code of a shell."""
    os.write(2, b"interrupted\n" if number == signal.SIGINT else b"terminated\n")
    os._exit(128 + number)
