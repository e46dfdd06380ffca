"""Ctrl-C while a command imports its libraries. Imports next to nothing itself."""

import os
import signal


class BriefInterrupt:
    """While it is entered, Ctrl-C is one line and exit code 130: an import could turn it into another error."""

    def __enter__(self) -> None:
        self._handles = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # nohup ignores it
        if self._handles:
            try:
                signal.signal(signal.SIGINT, _end)
            except ValueError:  # not in the main thread
                self._handles = False

    def __exit__(self, *_: object) -> None:
        if self._handles:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def _end(*_: object) -> None:
    os.write(2, b"interrupted\n")
    os._exit(128 + signal.SIGINT)
