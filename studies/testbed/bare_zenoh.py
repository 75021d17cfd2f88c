"""The traffic of a session over bare Zenoh: what its messages cost without loops, checks and tags.

Three processes, as in a session with a recorder: the same sessions, publishers, priority, way of
waiting, sizes and rate. The master sends a command every millisecond and waits for the state that
answers it; each side then sends what it has for the recorder, which copies all messages.
"""

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import zenoh

from studies.testbed.processes import find_free_ports
from teleop.link.network import declare_publisher, open_session
from teleop.link.reception import Inbox
from teleop.messages.messages import Command, Hand, SlaveState, TendonState
from teleop.runtime.child_process import start_module
from teleop.runtime.clock import Grid, pause_garbage_collection
from teleop.runtime.process import die_with_launcher
from teleop.runtime.realtime import enter_loop, request_realtime
from teleop.security import CertificateRole
from teleop.security.credentials import create_local_credentials

SESSION, RATE_HZ = "bare", 1000.0
ANSWER_TIMEOUT_NS = 600_000  # as long as the master of a session waits
ROLES = ("record", "slave", "master")
MESSAGES = (Command, SlaveState, TendonState, Hand)


@contextmanager
def run_bare_traffic() -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """Run the traffic; gives its processes by role."""
    endpoints = [f"127.0.0.1:{port}" for port in find_free_ports(2)]
    with ExitStack() as stack:
        running = {}
        for role in ROLES:
            running[role] = start_module(
                "studies.testbed.bare_zenoh", role, *endpoints,
                is_supervised=True, stdin=subprocess.PIPE,
            )  # fmt: skip
            stack.callback(running[role].communicate)  # ends it
        yield running


def main(role: str, master: str, slave: str) -> None:
    """Be the process of a role until standard input closes."""
    die_with_launcher()
    granted = request_realtime()
    listen, connect, certificate = {
        "record": ([], [master, slave], CertificateRole.RECORDER),
        "slave": ([slave], [], CertificateRole.SLAVE),
        "master": ([master], [slave], CertificateRole.MASTER),
    }[role]
    credentials = create_local_credentials(SESSION, certificate)
    closed = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), closed.set()), daemon=True).start()
    with open_session(credentials, listen, connect) as session, pause_garbage_collection():
        if role == "record":
            for message in MESSAGES:
                _subscribe(session, message.__name__, lambda sample: sample.payload.to_bytes())
            closed.wait()
            return
        inbox = Inbox(16)
        sent, answered, reported = (
            (Command, SlaveState, Hand) if role == "master" else (SlaveState, Command, TendonState)
        )
        _subscribe(session, answered.__name__, inbox.store)
        put, report = (_build_put(session, message) for message in (sent, reported))
        enter_loop(granted)
        if role == "slave":
            while not closed.is_set():
                if inbox.wait(time.monotonic_ns() + 50_000_000) and inbox.take()[0]:
                    put()
                    report()
            return
        for _ in Grid(RATE_HZ, closed.is_set):
            put()
            if inbox.wait(time.monotonic_ns() + ANSWER_TIMEOUT_NS):
                inbox.take()
            report()


def _subscribe(session, name, store) -> None:
    session.declare_subscriber(f"{SESSION}/{name}", zenoh.handlers.Callback(store, indirect=False))


def _build_put(session, message):
    publisher = declare_publisher(session, f"{SESSION}/{message.__name__}", True, False)
    data = bytes(message.schema.size)
    return lambda: publisher.put(data)


if __name__ == "__main__":
    main(*sys.argv[1:])
