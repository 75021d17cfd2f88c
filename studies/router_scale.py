"""What a router carries: sessions at 1 kHz, beside the same sessions connected directly.

  python -m studies.router_scale [--sessions 1 2 4 8 16] [--seconds 3] [--out FILE] [--insecure]

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
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
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
PHASES = 4  # sendings in a millisecond, each of a part of the sessions
PERIOD_NS = 1_000_000
CONNECT_S = 30.0
FAN_OUT = (0, 2, 4, 8)  # listeners of one session
_STAMP = 8  # bytes, of the clock at the master


def build_name(number: int) -> str:
    """Return the name of a session."""
    return f"scale-{number}"


def prepare_security(role: CertificateRole, insecure: bool, sessions: list[str]) -> tuple[Any, Any]:
    """Return the credentials and the access control of a process."""
    if insecure:
        return None, None
    of = ALL_SESSIONS if role is CertificateRole.ROUTER else sessions[0]
    return create_local_credentials(of, role), build_access_control(sessions)


class Side:
    """All masters, all slaves or all listeners: a Zenoh session for each."""

    def __init__(self, plan: dict[str, Any], role: CertificateRole, listens: bool) -> None:
        self.plan = plan
        mode: Any = "client" if plan["router"] else "peer"
        self.sessions = []
        for number in range(plan["sessions"]):
            if plan["router"]:
                ends: tuple[list[str], list[str]] = ([], [plan["router"]])
            else:
                slave = plan["slaves"][number]
                ends = ([slave], []) if listens else ([], [slave])
            keys, access = prepare_security(role, plan["insecure"], [build_name(number)])
            self.sessions.append(open_session(keys, *ends, access, mode))

    def subscribe(self, topic: str, number: int, store: Callable[[Any], None]) -> None:
        """Receive a topic of one session."""
        direct = zenoh.handlers.Callback(store, indirect=False)
        self.sessions[number].declare_subscriber(f"teleop/{build_name(number)}/{topic}", direct)

    def publisher(self, topic: str, number: int) -> Any:
        """Return the publisher of a topic of one session."""
        key = f"teleop/{build_name(number)}/{topic}"
        return declare_publisher(self.sessions[number], key, live=True, patient=False)


def run_slaves(plan: dict[str, Any]) -> None:
    """Answer each command at once."""
    side = Side(plan, CertificateRole.SLAVE, listens=True)
    for number in range(plan["sessions"]):
        put = side.publisher("state", number).put

        def answer(sample: Any, put: Callable[[bytes], None] = put) -> None:
            put(sample.payload.to_bytes()[:_STAMP].ljust(SIZES["state"], b"\0"))

        side.subscribe("command", number, answer)
    print("ready", flush=True)
    sys.stdin.read()


def run_listeners(plan: dict[str, Any]) -> None:
    """Receive commands and states of session 0, several times."""
    keys, access = prepare_security(CertificateRole.VIEWER, plan["insecure"], [build_name(0)])
    router = [plan["router"]]
    sessions = [open_session(keys, [], router, access, "client") for _ in range(plan["listeners"])]
    for session in sessions:
        for topic in SIZES:
            direct = zenoh.handlers.Callback(lambda _: None, indirect=False)
            session.declare_subscriber(f"teleop/{build_name(0)}/{topic}", direct)
    print("ready", flush=True)
    sys.stdin.read()


def run_masters(plan: dict[str, Any]) -> None:
    """Send commands on an absolute grid, and print the round trips."""
    count = plan["sessions"]
    side = Side(plan, CertificateRole.MASTER, listens=False)
    trips: list[list[int]] = [[] for _ in range(count)]
    for number in range(count):

        def store(sample: Any, trip: list[int] = trips[number]) -> None:
            now = time.monotonic_ns()
            trip.append(now - int.from_bytes(sample.payload.to_bytes()[:_STAMP], "little"))

        side.subscribe("state", number, store)
    puts = [side.publisher("command", number).put for number in range(count)]
    end = time.monotonic() + CONNECT_S
    while not all(trips):
        if time.monotonic() > end:
            raise SystemExit("not all sessions were connected in time")
        for put in puts:
            put(_command())
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
    print(json.dumps({"delivered_hz": min(rates), "p50_ms": p50, "p99_ms": p99}), flush=True)


def send_commands(puts: list[Callable[[bytes], None]], seconds: float) -> float:
    """Send on all sessions, each once a millisecond; return the time that it took [s]."""
    phases = [puts[phase::PHASES] for phase in range(PHASES)]
    begin = due = time.monotonic_ns()
    for step in range(round(seconds * 1e9 / PERIOD_NS) * PHASES):
        due = begin + step * PERIOD_NS // PHASES
        wait = due - time.monotonic_ns()
        if wait > 0:
            time.sleep(wait * 1e-9)
        for put in phases[step % PHASES]:
            put(_command())
    return (time.monotonic_ns() - begin) * 1e-9


def _command() -> bytes:
    return time.monotonic_ns().to_bytes(_STAMP, "little").ljust(SIZES["command"], b"\0")


def run_router(plan: dict[str, Any]) -> None:
    """Run a router as `teleop router` does."""
    names = [build_name(number) for number in range(plan["most"])]
    keys, access = prepare_security(CertificateRole.ROUTER, plan["insecure"], names)
    with open_session(keys, [plan["router"]], [], access, "router"):
        print("ready", flush=True)
        sys.stdin.read()


PART = "part"  # the word that makes this program one of its processes
PARTS = {
    "router": run_router, "slaves": run_slaves, "masters": run_masters,
    "listeners": run_listeners,
}  # fmt: skip


class Part:
    """A process of the benchmark, ended with the context."""

    def __init__(self, name: str, plan: dict[str, Any]) -> None:
        pipe = subprocess.PIPE
        self.process = start_module(
            "studies.router_scale", PART, name, json.dumps(plan),
            is_supervised=True, stdin=pipe, stdout=pipe, text=True,
        )  # fmt: skip

    def __enter__(self) -> "Part":
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.communicate()

    def line(self) -> str:
        """Return the next line that it prints."""
        assert self.process.stdout is not None  # noqa: S101 - given as PIPE above
        line = self.process.stdout.readline().strip()
        if not line:
            raise SystemExit("a process of the benchmark ended")
        return line

    def cpu_s(self) -> float:
        """Return the processor time so far [s]."""
        return read_processor_s(self.process.pid)


def measure_sessions(plan: dict[str, Any], router: Part | None) -> dict[str, Any]:
    """Measure one number of sessions, through a router or directly."""
    listeners = plan["listeners"]
    with Part("slaves", plan) as slaves:
        slaves.line()
        others = [slaves]
        with Part("listeners", plan) if listeners else slaves as ears:
            if listeners:
                ears.line()
                others.append(ears)
            with Part("masters", plan) as masters:
                others.append(masters)
                masters.line()  # begin
                begin = time.monotonic()
                before = [part.cpu_s() for part in others]
                router_before = router.cpu_s() if router else 0.0
                masters.line()  # end
                seconds = time.monotonic() - begin
                load = sum(p.cpu_s() - b for p, b in zip(others, before, strict=True))
                router_s = router.cpu_s() - router_before if router else 0.0
                result = json.loads(masters.line())
    sent = result["delivered_hz"] * 2 * (plan["sessions"] + listeners)  # messages a second
    return {
        "sessions": plan["sessions"],
        "listeners": listeners,
        "way": "router" if router else "direct",
        **result,
        "router_cores": router_s / seconds,
        "router_us_per_message": router_s / seconds / sent * 1e6,
        "load_cores": load / seconds,
    }


def print_row(row: dict[str, Any]) -> None:
    router = "" if row["way"] == "direct" else (
        f"{row['router_cores']:6.2f} {row['router_us_per_message']:7.1f}"
    )  # fmt: skip
    print(
        f"{row['sessions']:8} {row['listeners']:9} {row['way']:7} {row['delivered_hz']:9.1f} "
        f"{row['p50_ms']:7.3f} {row['p99_ms']:7.3f} {row['load_cores']:6.2f} {router}",
        flush=True,
    )


def measure_all(sessions: list[int], seconds: float, insecure: bool) -> list[dict[str, Any]]:
    """Measure all numbers of sessions both ways, then the fan-out of one session."""
    (port,) = find_free_ports(1)
    routed = {
        "router": f"127.0.0.1:{port}",
        "most": max(sessions),
        "insecure": insecure,
        "seconds": seconds,
    }
    rows = []
    print("sessions listeners way     delivered     p50     p99   load router  us/msg")
    with Part("router", routed) as router:
        router.line()
        for count in sessions:
            plan = routed | {"sessions": count, "listeners": 0}
            slaves = [f"127.0.0.1:{port}" for port in find_free_ports(count)]
            for config, via in ((plan | {"router": "", "slaves": slaves}, None), (plan, router)):
                rows.append(measure_sessions(config, via))
                print_row(rows[-1])
        for listeners in FAN_OUT[1:]:
            rows.append(measure_sessions(routed | {"sessions": 1, "listeners": listeners}, router))
            print_row(rows[-1])
    return rows


def describe_machine() -> dict[str, Any]:
    """Return what the figures hold for."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return {
        "processor": names[0] if names else platform.processor(),
        "cores": os.cpu_count(),
        "kernel": platform.release(),
        "python": platform.python_version(),
        "load_average": os.getloadavg()[0],
        "scheduling": request_realtime(),
    }


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
        out=(Path, "write the rows as JSON to this file"),
        insecure=(False, "plaintext, without TLS"),
    )
    facts = {"machine": describe_machine(), "bytes": SIZES, "tls": not args.insecure}
    print(json.dumps(facts))
    rows = measure_all(args.sessions, args.seconds, args.insecure)
    if args.out:
        args.out.write_text(json.dumps(facts | {"rows": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
