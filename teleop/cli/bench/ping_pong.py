"""Round-trip time of bare Zenoh on this machine: the baseline for the latency of a session.

Two processes on loopback send raw bytes to and fro, without messages, checks or loops. They have
the same sessions, publishers, priority and way of waiting as the loops (`teleop.link.reception`),
so the additional latency of a session is due to the loops.
"""

import json
import subprocess
import sys
import threading
import time
from dataclasses import asdict
from typing import Any

import numpy as np
import zenoh

from teleop.link.network import declare_publisher, open_session
from teleop.link.reception import Inbox
from teleop.runtime.child_process import start_module
from teleop.runtime.clock import pause_garbage_collection
from teleop.runtime.process import die_with_launcher
from teleop.runtime.realtime import RealtimeConfig, enter_loop, request_realtime
from teleop.security import CertificateRole
from teleop.security.credentials import create_local_credentials
from teleop.session.own_endpoints import find_free_ports

PERIOD_S = 1e-3  # between two commands, as in a 1 kHz session
ANSWER_TIMEOUT_S = 0.05  # timeout of an answer
START_S = 5.0  # timeout for the start of the other process
_NUMBER_BYTES = 8  # bytes: a command begins with its number, an answer with that of its command
_INBOX_SIZE = 16
_SESSION = "ping-pong"
_DEFAULT = RealtimeConfig()


def measure_ping_pong(
    command_bytes: int, state_bytes: int, n: int = 1000, realtime: RealtimeConfig = _DEFAULT
) -> dict[str, Any]:
    """Measure `n` round trips between two new processes.

    One command is sent per millisecond. Returns `n` answered; `p50_ms`, `p99_ms`, `p99_9_ms` of the
    round trip; nothing without an answer.
    """
    endpoint, scheduling = f"127.0.0.1:{find_free_ports(1)[0]}", json.dumps(asdict(realtime))
    pong = _start_process("pong", endpoint, str(state_bytes), scheduling)
    try:
        ping = _start_process("ping", endpoint, str(command_bytes), scheduling, str(n))
        try:
            out, _ = ping.communicate()
        finally:
            ping.kill()
            ping.wait()
    finally:
        pong.communicate()
    result: dict[str, Any] = json.loads(out or b"{}")
    return result


def _start_process(*words: str) -> subprocess.Popen[bytes]:
    return start_module(
        "teleop.cli.bench.ping_pong",
        *words,
        is_supervised=True,
        stdin=subprocess.PIPE,  # pong ends when this closes
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )


def _run_ping(endpoint: str, size: int, realtime: RealtimeConfig, n: int) -> dict[str, Any]:
    """Send `n` commands and return their round trips."""
    granted = request_realtime(realtime)
    with open_session(
        create_local_credentials(_SESSION, CertificateRole.MASTER), [], [endpoint]
    ) as session:
        inbox = _subscribe_inbox(session, "pong")
        publisher = declare_publisher(session, "teleop-ping-pong/ping", live=True, patient=False)
        enter_loop(granted, realtime)
        deadline = time.monotonic() + START_S
        while _measure_round_trip(publisher, inbox, size, n) is None:
            if time.monotonic() > deadline:
                return {}
        round_trips = []
        with pause_garbage_collection():
            begin = time.monotonic()
            for k in range(n):
                time.sleep(max(0.0, begin + k * PERIOD_S - time.monotonic()))
                answer = _measure_round_trip(publisher, inbox, size, k)
                if answer is not None:
                    round_trips.append(answer)
    if not round_trips:
        return {}
    p50, p99, p99_9 = np.percentile(np.array(round_trips) * 1e-6, [50.0, 99.0, 99.9]).tolist()
    return {"n": len(round_trips), "p50_ms": p50, "p99_ms": p99, "p99_9_ms": p99_9}


def _measure_round_trip(publisher: zenoh.Publisher, inbox: Inbox, size: int, k: int) -> int | None:
    """Send command `k`; return the round trip [ns], or None if no answer comes."""
    number = k.to_bytes(_NUMBER_BYTES, "little")
    command = number.ljust(size, b"\0")
    sent = time.monotonic_ns()
    publisher.put(command)
    while inbox.wait(sent + round(ANSWER_TIMEOUT_S * 1e9)):
        now = time.monotonic_ns()
        for data, _ in inbox.take()[0]:
            if data.startswith(number):
                return now - sent
    return None


def _run_pong(endpoint: str, size: int, realtime: RealtimeConfig) -> None:
    """Answer every command until standard input closes."""
    granted = request_realtime(realtime)
    with open_session(
        create_local_credentials(_SESSION, CertificateRole.SLAVE), [endpoint], []
    ) as session:
        inbox = _subscribe_inbox(session, "ping")
        publisher = declare_publisher(session, "teleop-ping-pong/pong", live=True, patient=False)
        closed = threading.Event()
        threading.Thread(target=_wait_for_end_of_input, args=(closed,), daemon=True).start()
        enter_loop(granted, realtime)
        with pause_garbage_collection():
            while not closed.is_set():
                if not inbox.wait(time.monotonic_ns() + round(ANSWER_TIMEOUT_S * 1e9)):
                    continue
                for command, _ in inbox.take()[0]:
                    publisher.put(command[:_NUMBER_BYTES].ljust(size, b"\0"))


def _wait_for_end_of_input(closed: threading.Event) -> None:
    sys.stdin.read()
    closed.set()


def _subscribe_inbox(session: zenoh.Session, name: str) -> Inbox:
    """Return the inbox of the messages of `name`, as in `Link.subscribe_latest`."""
    inbox = Inbox(_INBOX_SIZE)
    direct = zenoh.handlers.Callback(inbox.store, indirect=False)
    session.declare_subscriber(f"teleop-ping-pong/{name}", direct)
    return inbox


def main(words: list[str]) -> None:
    """Run one of the two processes: `ping|pong ENDPOINT BYTES SCHEDULING [N]`."""
    die_with_launcher()
    side, endpoint, size, scheduling = words[:4]
    realtime = RealtimeConfig(**json.loads(scheduling))
    if side == "pong":
        _run_pong(endpoint, int(size), realtime)
    else:
        print(json.dumps(_run_ping(endpoint, int(size), realtime, int(words[4]))), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
