"""Messages between the parent and a thread of a worker, over a two-way connection.

multiprocessing's own messages cost two reads each, and its checks as much again: of the parent's cost per round, most.
Here a message is its length (uint32, the machine's own byte order) and its bytes, written by one call and read by one,
several at a time if so many have come. Windows has no such descriptors; there messages stay multiprocessing's.
"""

from __future__ import annotations

import os
import struct
import sys
from multiprocessing.connection import Connection

_LENGTH = struct.Struct("=I")
_READ = 1 << 16
"""Bytes asked for at a time; nearly all messages are far shorter."""


def framed(message: bytes) -> bytes:
    """A message as `Channel.send` takes it."""
    return message if sys.platform == "win32" else _LENGTH.pack(len(message)) + message


class Channel:
    """One end of a connection, for one thread."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._descriptor = connection.fileno()
        self._rest = b""
        """The beginning of a message whose end has not come."""

    def send(self, message: bytes) -> None:
        """Send a framed message. Raises OSError when nobody will read it."""
        if sys.platform == "win32":
            self._connection.send_bytes(message)
            return
        sent = os.write(self._descriptor, message)
        while sent < len(message):
            sent += os.write(self._descriptor, message[sent:])

    def receive(self) -> list[bytes]:
        """Wait for something, and give the messages that are whole; none where one has only begun to come.

        Raises EOFError or OSError when nothing will come any more.
        """
        if sys.platform == "win32":
            return [self._connection.recv_bytes()]
        data = os.read(self._descriptor, _READ)
        if not data:
            raise EOFError
        if self._rest:
            data = self._rest + data
        messages, start = [], 0
        while len(data) >= start + _LENGTH.size:
            begin = start + _LENGTH.size
            end = begin + _LENGTH.unpack_from(data, start)[0]
            if end > len(data):
                break
            messages.append(data[begin:end])
            start = end
        self._rest = data[start:]
        return messages
