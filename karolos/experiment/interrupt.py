"""Handles Ctrl-C while a command imports its libraries, and SIGTERM if nothing else does.

It and the packages above it import almost nothing: until it is imported, Ctrl-C prints a traceback.
"""

import os
import signal


class BriefInterrupt:
    """Inside the block Ctrl-C gives one line and exit code 130. An import could turn it into another error."""

    def __enter__(self) -> None:
        self._handles = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # nohup ignores it
        if self._handles:
            try:
                signal.signal(signal.SIGINT, end_at_once)
            except ValueError:  # this is not the main thread, which alone gets signals
                self._handles = False

    def __exit__(self, *_: object) -> None:
        if self._handles:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def end_at_once(number: int, _: object) -> None:
    """A handler of signals that ends the process with a line and the exit code of a shell."""
    os.write(2, b"interrupted\n" if number == signal.SIGINT else b"terminated\n")
    os._exit(128 + number)
