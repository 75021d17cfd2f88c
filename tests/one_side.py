"""One side of a session as a command inside the test process, on free ports."""

import argparse
import contextlib
import signal
import socket

from teleop.runtime.process import TERMINATION_SIGNALS
from teleop.session import loop_process


@contextlib.contextmanager
def without_traces(monkeypatch):
    """Let a command run without leaving its signal handlers and priorities here."""
    before = {number: signal.getsignal(number) for number in TERMINATION_SIGNALS}
    monkeypatch.setattr(loop_process, "request_realtime", lambda _: ["a test"])
    monkeypatch.setattr(loop_process, "enter_loop", lambda *_: None)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def arguments_of(process, *words):
    """Return the arguments of a session alone on this machine."""
    links = []
    for name in ("master", "slave"):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            links.append(f"--set=link.{name}=127.0.0.1:{probe.getsockname()[1]}")
    parser = argparse.ArgumentParser()
    process.add_arguments(parser)
    return parser.parse_args([*links, "--set=session=alone", *words])
