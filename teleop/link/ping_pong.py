"""What Zenoh alone takes on this machine: the yardstick for the latency of a session.

Two processes on loopback throw raw bytes to and fro over the same kind of session and publisher as
the link uses, without messages, checks or loops.
"""

import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from teleop.link.config import LinkConfig
from teleop.link.network import declare_publisher, open_session

PERIOD_S = 1e-3  # between two throws, as in a 1 kHz session
PATIENCE_S = 0.05  # for an answer, before the next throw
START_S = 5.0  # for the other process to come up
_WORD = 8  # bytes: a ball begins with its number, an answer with that and its own stamp


def ping_pong(command_bytes: int, state_bytes: int, n: int = 1000) -> dict[str, Any]:
    """Measure `n` round trips between this process and one that it starts and ends.

    Parameters
    ----------
    command_bytes, state_bytes : int
        Size of what is thrown, and of what comes back.
    n : int
        How many throws, one a millisecond.

    Returns
    -------
    dict
        `n` answered; `p50_ms`, `p99_ms`, `p99_9_ms` of the round trip; the same with `one_way_` in
        front of the way back. Empty if the other process did not answer.
    """
    endpoint = f"tcp/127.0.0.1:{_free_port()}"
    root = str(Path(__file__).parents[2])
    path = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
    pong = subprocess.Popen(
        [sys.executable, "-m", "teleop.link.ping_pong", endpoint, str(state_bytes)],
        stdin=subprocess.PIPE,  # it ends when this closes, so it cannot outlive us
        stderr=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": path},
        start_new_session=True,  # Ctrl-C is for us to handle
    )
    try:
        with open_session(LinkConfig(), [], [endpoint]) as session:
            return _throw(session, command_bytes, n)
    finally:
        pong.communicate()


def percentiles_ms(durations_ns: list[int], prefix: str = "") -> dict[str, float]:
    """Return p50, p99 and p99.9 in milliseconds."""
    p50, p99, p99_9 = np.percentile(np.array(durations_ns) * 1e-6, [50.0, 99.0, 99.9]).tolist()
    return {f"{prefix}p50_ms": p50, f"{prefix}p99_ms": p99, f"{prefix}p99_9_ms": p99_9}


def _throw(session: zenoh.Session, size: int, n: int) -> dict[str, Any]:
    ring: Any = session.declare_subscriber("teleop-ping-pong/pong", zenoh.handlers.RingChannel(1))
    publisher = declare_publisher(session, "teleop-ping-pong/ping", live=True, patient=False)
    deadline = time.monotonic() + START_S
    while _answer(publisher, ring, size, n) is None:
        if time.monotonic() > deadline:
            return {}
    round_trips, ways_back = [], []
    begin = time.monotonic()
    for k in range(n):
        time.sleep(max(0.0, begin + k * PERIOD_S - time.monotonic()))
        answer = _answer(publisher, ring, size, k)
        if answer is not None:
            round_trips.append(answer[0])
            ways_back.append(answer[1])
    if not round_trips:
        return {}
    result: dict[str, Any] = {"n": len(round_trips)}
    return result | percentiles_ms(round_trips) | percentiles_ms(ways_back, "one_way_")


def _answer(publisher: zenoh.Publisher, ring: Any, size: int, k: int) -> tuple[int, int] | None:
    """Throw ball `k` and return (round trip, way back) [ns]; None if it does not come back."""
    number = k.to_bytes(_WORD, "little")
    ball = number.ljust(size, b"\0")
    thrown = time.monotonic_ns()
    publisher.put(ball)
    while (now := time.monotonic_ns()) - thrown < PATIENCE_S * 1e9:
        sample = ring.try_recv()
        if sample is None:
            continue
        now, data = time.monotonic_ns(), sample.payload.to_bytes()
        if data.startswith(number):
            return now - thrown, now - int.from_bytes(data[_WORD : 2 * _WORD], "little")
    return None


def _pong(endpoint: str, size: int) -> None:
    """Answer every ball until standard input closes."""
    with open_session(LinkConfig(), [endpoint], []) as session:
        ring: Any = session.declare_subscriber(
            "teleop-ping-pong/ping", zenoh.handlers.RingChannel(1)
        )
        publisher = declare_publisher(session, "teleop-ping-pong/pong", live=True, patient=False)

        def answer() -> None:
            for ball in ring:
                number = ball.payload.to_bytes()[:_WORD]
                stamp = time.monotonic_ns().to_bytes(_WORD, "little")
                publisher.put((number + stamp).ljust(size, b"\0"))

        threading.Thread(target=answer, daemon=True).start()
        sys.stdin.read()
        os._exit(0)  # the thread is waiting inside Zenoh


def _free_port() -> int:
    """Return a port that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


if __name__ == "__main__":
    _pong(sys.argv[1], int(sys.argv[2]))
