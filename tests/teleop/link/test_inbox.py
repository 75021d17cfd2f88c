"""The queue between Zenoh's thread and the loop's."""

import os
import signal
import threading
import time
from types import SimpleNamespace

from hypothesis import given
from hypothesis import strategies as st

from teleop.link.reception import Inbox


def sample(number):
    data = number.to_bytes(4, "little")
    return SimpleNamespace(payload=SimpleNamespace(to_bytes=lambda: data))


def numbers(arrived):
    return [int.from_bytes(data, "little") for data, _ in arrived]


@given(st.integers(1, 8), st.lists(st.integers(0, 12), max_size=8))
def test_the_newest_are_kept_in_order_and_what_was_dropped_is_said(size, bursts):
    inbox, sent = Inbox(size), 0
    for burst in bursts:
        for _ in range(burst):
            inbox.store(sample(sent))
            sent += 1
        arrived, overflowed = inbox.take()
        kept = min(burst, size)
        assert numbers(arrived) == list(range(sent - kept, sent))
        assert overflowed == (burst > size)
    assert inbox.take() == ([], False)


def test_what_was_waited_for_counts_among_those_that_are_kept():
    inbox = Inbox(3)
    for number in range(4):
        inbox.store(sample(number))
    assert inbox.wait(time.monotonic_ns())  # has the oldest in hand, which is dropped then
    arrived, overflowed = inbox.take()
    assert numbers(arrived) == [1, 2, 3]
    assert overflowed


def test_waiting_ends_with_an_arrival_which_is_not_lost():
    inbox = Inbox(4)
    threading.Timer(0.05, inbox.store, [sample(7)]).start()
    begin = time.monotonic_ns()
    assert inbox.wait(begin + 5_000_000_000)
    assert time.monotonic_ns() - begin < 4_000_000_000
    assert inbox.wait(begin)  # it is still there
    inbox.store(sample(8))
    assert numbers(inbox.take()[0]) == [7, 8]


def test_waiting_ends_at_the_deadline():
    inbox = Inbox(4)
    begin = time.monotonic_ns()
    assert not inbox.wait(begin + 20_000_000)
    assert time.monotonic_ns() - begin >= 19_000_000
    assert not inbox.wait(begin)


def test_what_came_before_the_deadline_that_has_passed_is_there():
    inbox = Inbox(4)
    inbox.store(sample(1))
    assert inbox.wait(time.monotonic_ns() - 1)


def test_a_wait_ends_though_its_deadline_passes_before_it_begins():
    """Of CPython's `SimpleQueue.get` one in a few hundred of these would wait for ever."""
    inbox, ended = Inbox(4), 0

    def wait_often():
        nonlocal ended
        for _ in range(3000):
            inbox.store(sample(1))  # which frees the lock of the queue when it is taken
            inbox.wait(time.monotonic_ns())
            inbox.take()
            inbox.wait(time.monotonic_ns() + 2000)
            ended += 1

    waiting = threading.Thread(target=wait_often, daemon=True)
    waiting.start()
    waiting.join(60.0)
    assert ended == 3000


def test_a_signal_ends_a_wait_however_long_its_handler_takes():
    """CPython's own `SimpleQueue.get` would wait for ever here: nothing else comes."""
    inbox = Inbox(4)

    def handler(_number, _frame):
        time.sleep(0.1)  # longer than what is left of the wait
        inbox.wake()

    before = signal.signal(signal.SIGUSR1, handler)
    try:
        threading.Timer(0.02, os.kill, (os.getpid(), signal.SIGUSR1)).start()
        begin = time.monotonic_ns()
        assert not inbox.wait(begin + 50_000_000)
        assert time.monotonic_ns() - begin < 5_000_000_000
    finally:
        signal.signal(signal.SIGUSR1, before)
    inbox.store(sample(3))
    inbox.wake()
    inbox.store(sample(4))
    assert numbers(inbox.take()[0]) == [3, 4]
