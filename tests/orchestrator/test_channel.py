"""Messages between parent and worker arrive whole, in order, and as many as were sent."""

import multiprocessing
import sys
import threading

import pytest

from karolos.orchestrator.channel import Channel, framed


@pytest.fixture
def ends():
    one, other = multiprocessing.Pipe()
    with one, other:
        yield one, other


def received(channel, count):
    messages = []
    while len(messages) < count:
        messages += channel.receive()
    return messages


def test_messages_arrive_whole_and_in_order(ends):
    here, there = map(Channel, ends)
    sent = [b".", b"", b"s" + bytes(range(256)), b"!" * 70_000, b"."]
    writer = threading.Thread(target=lambda: [here.send(framed(message)) for message in sent])
    writer.start()
    assert received(there, len(sent)) == sent
    writer.join()
    there.send(framed(b"back"))
    assert here.receive() == [b"back"]


def test_what_is_larger_than_a_socket_holds_arrives(ends):
    here, there = map(Channel, ends)
    message = bytes(range(256)) * 20_000
    writer = threading.Thread(target=here.send, args=(framed(message),))
    writer.start()
    assert received(there, 1) == [message]
    writer.join()


@pytest.mark.skipif(sys.platform == "win32", reason="multiprocessing's own messages come one at a time")
def test_what_has_come_is_given_at_once_and_half_a_message_is_kept(ends):
    here, there = map(Channel, ends)
    whole = framed(b"half a message")
    here.send(framed(b"one") + framed(b"two") + whole[:6])
    assert there.receive() == [b"one", b"two"]
    here.send(whole[6:9])
    assert there.receive() == []
    here.send(whole[9:])
    assert there.receive() == [b"half a message"]


def test_the_end_is_an_error_on_both_ways(ends):
    here, there = map(Channel, ends)
    here.send(framed(b"last"))
    ends[0].close()
    assert there.receive() == [b"last"]
    with pytest.raises((EOFError, OSError)):
        there.receive()
    with pytest.raises(BrokenPipeError):
        there.send(framed(b"nobody"))
