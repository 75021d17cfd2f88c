"""Keys of the launcher's terminal: a pseudo-terminal stands for it."""

import os
import pty
import sys
import termios
import time
from contextlib import suppress

import pytest

from teleop.launch.console import KeyReader


@pytest.fixture
def terminal(monkeypatch):
    """Return the other end of a terminal that is our standard input and our foreground."""
    far, near = pty.openpty()
    with open(near) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        monkeypatch.setattr(os, "tcgetpgrp", lambda _: os.getpgrp())
        yield far, near
    os.close(far)


def test_a_key_is_heard_at_once_without_enter_and_unseen(terminal):
    far, _ = terminal
    with KeyReader() as keys:
        assert keys.there
        os.write(far, b" ")
        begin = time.monotonic()
        assert keys.wait(5.0) == " "
        assert time.monotonic() - begin < 2.0
        assert keys.wait(0.01) == ""
        os.set_blocking(far, False)
        with pytest.raises(BlockingIOError):
            os.read(far, 10)


def test_the_terminal_is_left_as_it_was_whatever_happened(terminal):
    _, near = terminal
    before = termios.tcgetattr(near)
    with suppress(ZeroDivisionError), KeyReader():
        assert termios.tcgetattr(near) != before
        raise ZeroDivisionError
    assert termios.tcgetattr(near) == before


def test_in_the_background_the_terminal_is_not_touched(terminal, monkeypatch):
    _, near = terminal
    monkeypatch.setattr(os, "tcgetpgrp", lambda _: os.getpgrp() + 1)
    before = termios.tcgetattr(near)
    with KeyReader() as keys:
        assert not keys.there
        assert keys.wait(0.001) == ""
        assert termios.tcgetattr(near) == before


def test_without_a_terminal_it_waits_and_hears_nothing(monkeypatch):
    with open(os.devnull) as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        with KeyReader() as keys:
            assert not keys.there
            assert keys.wait(0.001) == ""
