"""What a router carries: sessions at 1 kHz, beside the same sessions connected directly.

  python -m studies.router_scale [--sessions 1 2 4 8 16] [--seconds 3] [--insecure]

Each session is a command and an answer a millisecond, of the sizes of Command and SlaveState, with
the publishers, queues, priorities, TLS and access control of a link, but no tags and no loops. One
process holds the masters of all sessions, one the slaves, which answer at once, one the listeners,
and one is a router as `teleop router`. Sessions are spread over the millisecond. Reported for each
number of sessions:

  delivered   answers a second of a session, the least of all sessions
  p50, p99    round trip master - slave - master [ms]: four hops through the router, two directly
  router      processor of the router, in cores; and for each message that it sends on [us]
  load        processor of the processes that make the load, in cores: with the router's, it is the
              machine's limit that is seen when all cores are taken

Takes a minute and a half.
"""

import gc
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np
import zenoh

from studies.testbed.command import parse_options
from studies.testbed.processes import find_free_ports, read_processor_s
from teleop.link.network import declare_publisher, open_session
from teleop.messages.messages import Command, SlaveState
from teleop.runtime.child_process import start_module
from teleop.runtime.process import die_with_launcher
from teleop.runtime.realtime import request_realtime
from teleop.security import CertificateRole
from teleop.security.access import build_access_control
from teleop.security.credentials import create_local_credentials
from teleop.security.identity import ALL_SESSIONS

SIZES = {"command": Command.schema.size, "state": SlaveState.schema.size}
NAME = "scale-{}"  # of a session, by its number
PHASES = 4  # sendings in a millisecond, each of a part of the sessions
PERIOD_NS = 1_000_000
CONNECT_S = 30.0
FAN_OUT = (2, 4, 8)  # listeners of one session
_STAMP = 8  # bytes, of the clock at the master


def prepare_security(role: CertificateRole, insecure: bool, sessions: list[str]) -> tuple[Any, Any]:
    """Return the credentials and the access control of a process."""
    if insecure:
        return None, None
    of = ALL_SESSIONS if role is CertificateRole.ROUTER else sessions[0]
    return create_local_credentials(of, role), build_access_control(sessions)


class Side:
    """All masters, all slaves or all listeners of session 0: a Zenoh session for each."""

    def __init__(self, plan: dict[str, Any], role: CertificateRole, listens: bool = False) -> None:
        self.names = [NAME.format(number) for number in range(plan["sessions"])]
        if role is CertificateRole.VIEWER:
            self.names = self.names[:1] * plan["listeners"]
        mode: Any = "client" if plan["router"] else "peer"
        self.sessions = []
        for number, name in enumerate(self.names):
            address = [plan["router"] or plan["slaves"][number]]
            ends = (address, []) if listens and not plan["router"] else ([], address)
            keys, access = prepare_security(role, plan["insecure"], [name])
            self.sessions.append(open_session(keys, *ends, access, mode))

    def subscribe(self, topic: str, number: int, store: Callable[[Any], None]) -> None:
        """Receive a topic of one session."""
        direct = zenoh.handlers.Callback(store, indirect=False)
        self.sessions[number].declare_subscriber(f"teleop/{self.names[number]}/{topic}", direct)

    def declare_put(self, topic: str, number: int) -> Callable[[bytes], None]:
        """Return what publishes a topic of one session."""
        key = f"teleop/{self.names[number]}/{topic}"
        put: Callable[[bytes], None] = declare_publisher(
            self.sessions[number], key, live=True, patient=False
        ).put
        return put


def announce_and_wait() -> None:
    """Say that this process is ready, and wait for the end of its input."""
    print("ready", flush=True)
    sys.stdin.read()


def run_slaves(plan: dict[str, Any]) -> None:
    """Answer each command at once."""
    side = Side(plan, CertificateRole.SLAVE, listens=True)
    for number in range(plan["sessions"]):
        put_state = side.declare_put("state", number)

        def answer(sample: Any, put: Callable[[bytes], None] = put_state) -> None:
            put(sample.payload.to_bytes()[:_STAMP].ljust(SIZES["state"], b"\0"))

        side.subscribe("command", number, answer)
    announce_and_wait()


def run_listeners(plan: dict[str, Any]) -> None:
    """Receive commands and states of session 0, several times."""
    side = Side(plan, CertificateRole.VIEWER)
    for number in range(plan["listeners"]):
        for topic in SIZES:
            side.subscribe(topic, number, lambda _: None)
    announce_and_wait()


def run_masters(plan: dict[str, Any]) -> None:
    """Send commands on an absolute grid, and print the round trips."""
    count = plan["sessions"]
    side = Side(plan, CertificateRole.MASTER)
    trips: list[list[int]] = [[] for _ in range(count)]
    for number in range(count):

        def store(sample: Any, trip: list[int] = trips[number]) -> None:
            now = time.monotonic_ns()
            trip.append(now - int.from_bytes(sample.payload.to_bytes()[:_STAMP], "little"))

        side.subscribe("state", number, store)
    puts = [side.declare_put("command", number) for number in range(count)]
    end = time.monotonic() + CONNECT_S
    while not all(trips):
        if time.monotonic() > end:
            raise SystemExit("not all sessions were connected in time")
        for put in puts:
            put(build_command())
        time.sleep(0.05)
    gc.disable()
    send_commands(puts, 1.0)  # warm up
    for trip in trips:
        trip.clear()
    print("begin", flush=True)
    seconds = send_commands(puts, plan["seconds"])
    print("end", flush=True)
    time.sleep(0.1)
    rates = [len(trip) / seconds for trip in trips]
    p50, p99 = np.percentile(np.concatenate(trips) * 1e-6, [50.0, 99.0]).tolist()
    print(json.dumps((min(rates), p50, p99)), flush=True)


def send_commands(puts: list[Callable[[bytes], None]], seconds: float) -> float:
    """Send on all sessions, each once a millisecond; return the time that it took [s]."""
    phases = [puts[phase::PHASES] for phase in range(PHASES)]
    begin = time.monotonic_ns()
    for step in range(round(seconds * 1e9 / PERIOD_NS) * PHASES):
        wait = begin + step * PERIOD_NS // PHASES - time.monotonic_ns()
        if wait > 0:
            time.sleep(wait * 1e-9)
        for put in phases[step % PHASES]:
            put(build_command())
    return (time.monotonic_ns() - begin) * 1e-9


def build_command() -> bytes:
    """Return the bytes of a command that is sent now."""
    return time.monotonic_ns().to_bytes(_STAMP, "little").ljust(SIZES["command"], b"\0")


def run_router(plan: dict[str, Any]) -> None:
    """Run a router as `teleop router` does."""
    names = [NAME.format(number) for number in range(plan["most"])]
    keys, access = prepare_security(CertificateRole.ROUTER, plan["insecure"], names)
    with open_session(keys, [plan["router"]], [], access, "router"):
        announce_and_wait()


PART = "part"  # the word that makes this program one of its processes
PARTS = {
    "router": run_router, "slaves": run_slaves, "masters": run_masters,
    "listeners": run_listeners,
}  # fmt: skip


@contextmanager
def run_part(name: str, plan: dict[str, Any]) -> Iterator[subprocess.Popen[str]]:
    """Run a process of the benchmark, until the end of the context, from its first line on."""
    process = start_module(
        "studies.router_scale", PART, name, json.dumps(plan),
        is_supervised=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        read_line(process)
        yield process
    finally:
        process.kill()
        process.communicate()


def read_line(process: subprocess.Popen[str]) -> str:
    """Return the next line that a process prints."""
    assert process.stdout is not None  # noqa: S101 - a pipe
    if line := process.stdout.readline().strip():
        return line
    raise SystemExit("a process of the benchmark ended")


def print_row(plan: dict[str, Any], router: subprocess.Popen[str] | None) -> None:
    """Measure one number of sessions, through a router or directly, and print it."""
    sessions, listeners = plan["sessions"], plan["listeners"]
    with ExitStack() as stack:
        names = ("slaves", *(("listeners",) if listeners else ()), "masters")
        load = [stack.enter_context(run_part(name, plan)) for name in names]
        watched = [*load, *([router] if router else [])]
        begin, before = time.monotonic(), [read_processor_s(part.pid) for part in watched]
        read_line(load[-1])  # the end
        seconds = time.monotonic() - begin
        cores = [
            (read_processor_s(part.pid) - earlier) / seconds
            for part, earlier in zip(watched, before, strict=True)
        ]
        delivered_hz, p50_ms, p99_ms = json.loads(read_line(load[-1]))
    line = (
        f"{sessions:8} {listeners:9} {'router' if router else 'direct':7} {delivered_hz:9.1f} "
        f"{p50_ms:7.3f} {p99_ms:7.3f} {sum(cores[: len(load)]):6.2f}"
    )
    if router:
        messages_hz = delivered_hz * 2 * (sessions + listeners)
        line += f" {cores[-1]:6.2f} {cores[-1] / messages_hz * 1e6:7.1f}"
    print(line, flush=True)


def main() -> None:
    if sys.argv[1:2] == [PART]:
        die_with_launcher()
        request_realtime()  # before the sessions: their threads inherit the priority
        sys.setswitchinterval(0.0005)
        PARTS[sys.argv[2]](json.loads(sys.argv[3]))
        return
    args = parse_options(
        __doc__,
        sessions=((1, 2, 4, 8, 16), "numbers of sessions"),
        seconds=(3.0, "of each row"),
        insecure=(False, "plaintext, without TLS"),
    )
    address, *slaves = (f"127.0.0.1:{port}" for port in find_free_ports(1 + max(args.sessions)))
    direct = {
        "router": "", "slaves": slaves, "most": max(args.sessions), "listeners": 0,
        "insecure": args.insecure, "seconds": args.seconds,
    }  # fmt: skip
    routed = direct | {"router": address}
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, {request_realtime()}")
    print("sessions listeners way     delivered     p50     p99   load router  us/msg")
    with run_part("router", routed) as router:
        for count in args.sessions:
            print_row(direct | {"sessions": count}, None)
            print_row(routed | {"sessions": count}, router)
        for listeners in FAN_OUT:
            print_row(routed | {"sessions": 1, "listeners": listeners}, router)


if __name__ == "__main__":
    main()
