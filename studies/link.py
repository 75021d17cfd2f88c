"""Round trip of a Command and a SlaveState between two processes on loopback.

  python studies/link.py [N]

First raw bytes of the same sizes over bare Zenoh, then through the link: packed, checked, unpacked,
aged. Both throw once a millisecond and look for the answer without pause; the session's own
latency, which `teleop run` prints, has the wait for the next tick of each loop in it.
"""

import multiprocessing
import sys
import time
from multiprocessing.synchronize import Event

from teleop.link import Link, LinkConfig
from teleop.link.ping_pong import PERIOD_S, compute_percentiles_ms, measure_ping_pong
from teleop.messages.messages import Command, SlaveState
from teleop.messages.topics import COMMAND, STATE, Role
from teleop.runtime.clock import now_ns

CONFIG = LinkConfig(master="127.0.0.1:7457", slave="127.0.0.1:7458")
SESSION = "benchmark"


def slave(stop: Event) -> None:
    with Link(CONFIG, SESSION, Role.SLAVE) as link:
        link.subscribe_latest(COMMAND)
        while not stop.is_set():
            command = link.latest(COMMAND)
            if command.new:
                link.publish(STATE, SlaveState(echo_stamp_ns=command.message.stamp_ns))
            else:
                time.sleep(0)  # lets Zenoh's own threads in


def through_link(n: int) -> dict[str, float]:
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    process = context.Process(target=slave, args=(stop,))
    process.start()
    round_trips, ways_back = [], []
    with Link(CONFIG, SESSION, Role.MASTER) as link:
        link.subscribe_latest(STATE)
        while not link.present(Role.SLAVE):
            time.sleep(0.01)
        time.sleep(0.2)
        begin = time.monotonic()
        for k in range(n):
            time.sleep(max(0.0, begin + k * PERIOD_S - time.monotonic()))
            thrown = link.publish(COMMAND, Command())
            while (now := now_ns()) - thrown < 50_000_000:
                state = link.latest(STATE)
                if state.new and state.message.echo_stamp_ns == thrown:
                    now = now_ns()
                    round_trips.append(now - thrown)
                    ways_back.append(now - state.message.stamp_ns)
                    break
        print("counts:", state.counts)
    stop.set()
    process.join()
    return (
        {"n": len(round_trips)}
        | compute_percentiles_ms(round_trips)
        | compute_percentiles_ms(ways_back, "one_way_")
    )


def cost(link_role: Role = Role.SLAVE, n: int = 20_000) -> None:
    with Link(CONFIG, SESSION, link_role) as link:
        link.subscribe_latest(COMMAND)
        message = SlaveState()
        begin = time.perf_counter_ns()
        for _ in range(n):
            link.publish(STATE, message)
        published = time.perf_counter_ns()
        for _ in range(n):
            link.latest(COMMAND)
        looked = time.perf_counter_ns()
        for _ in range(n):
            link.check_peers()
        checked = time.perf_counter_ns()
        data = Command().pack(1, 2, 3)
        for _ in range(n):
            Command.unpack(data)
        unpacked = time.perf_counter_ns()
    print(
        f"publish {(published - begin) / n * 1e-3:.1f} us, "
        f"latest with nothing new {(looked - published) / n * 1e-3:.1f} us, "
        f"check_peers {(checked - looked) / n * 1e-3:.1f} us, "
        f"unpack a Command {(unpacked - checked) / n * 1e-3:.1f} us"
    )


def show(name: str, result: dict[str, float]) -> None:
    for way, prefix in (("round trip", ""), ("one way", "one_way_")):
        p50, p99, p99_9 = (result[f"{prefix}{p}_ms"] for p in ("p50", "p99", "p99_9"))
        print(f"{name:12} {way:10} p50 {p50:.3f}  p99 {p99:.3f}  p99.9 {p99_9:.3f} ms")


if __name__ == "__main__":
    throws = int(sys.argv[1]) if len(sys.argv) > 1 else 3000
    print(f"Command {Command.schema.size} bytes, SlaveState {SlaveState.schema.size} bytes")
    cost()
    show("bare Zenoh", measure_ping_pong(Command.schema.size, SlaveState.schema.size, throws))
    show("the link", through_link(throws))
