"""What `teleop ros` does to the loops, what it costs, and what arrives at a ROS node.

  python -m studies.ros [--seconds 8] [--rounds 3]

One session runs while `teleop ros` is, in turn, absent, there at 100 Hz and there at 250 Hz, with a
router and a subscriber of all topics in a process of their own. A recorder beside it tells the
period of both loops and the way from command to force in each state. Takes 3 minutes.
"""

import json
import sys
import tempfile
import time
from pathlib import Path

import zenoh

from studies.testbed.command import parse_options
from studies.testbed.observed import ObservedSession
from studies.testbed.processes import START_S, find_free_ports, read_processor_s, wait_for_condition
from teleop.runtime.child_process import end_process, start_module
from teleop.runtime.clock import now_ns
from teleop.runtime.process import write_text_file

SETTLE_S = 4.0  # [s] after a change of state that are not counted
MESSAGES_MIN = 100  # that have arrived when a measurement begins
RATES_HZ = (100, 250)
NODE = "node"  # the word that makes this program the ROS node


def main() -> None:
    if sys.argv[1:2] == [NODE]:
        run_node(sys.argv[2], Path(sys.argv[3]))
        return
    options = parse_options(__doc__, seconds=(8.0, "of each state"), rounds=(3, "of all states"))
    with tempfile.TemporaryDirectory(prefix="ros-benchmark-") as folder:
        with ObservedSession(Path(folder), options.seconds) as session:
            session.start_all()
            for _ in range(options.rounds):
                session.measure("off", SETTLE_S)
                for rate in RATES_HZ:
                    measure_rate(session, rate)
            session.stop("record", 60.0)
        session.report("ros")


def measure_rate(session: ObservedSession, rate_hz: int) -> None:
    """Measure the session beside `teleop ros`, and print what that cost and what arrived."""
    router, counts = f"tcp/127.0.0.1:{find_free_ports(1)[0]}", session.folder / "counts.json"
    counts.unlink(missing_ok=True)
    node = start_module("studies.ros", NODE, router, str(counts), is_supervised=True)
    settings = (f"ros.router={router}", f"ros.rate_hz={rate_hz}")
    shown = session.start("ros", *(word for text in settings for word in ("--set", text)))
    try:
        if not wait_for_condition(lambda: count_arrived(counts) > MESSAGES_MIN, START_S):
            raise SystemExit(f"nothing arrived at the ROS node\n{session.outputs()}")
        before, at_s = read_processor_s(shown.pid), time.monotonic()
        session.measure(f"{rate_hz} Hz", SETTLE_S)
        used = (read_processor_s(shown.pid) - before) / (time.monotonic() - at_s)
        session.stop("ros")
    finally:
        end_process(node, 10.0)
    heard = json.loads(counts.read_text())
    print(
        f"{rate_hz} Hz: {heard['messages'] / heard['seconds']:.0f} messages a second on "
        f"{heard['topics']} topics, {heard['lost']} lost; {100 * used:.1f} % of a core",
        flush=True,
    )


def count_arrived(counts: Path) -> int:
    """Return how many messages the node has counted."""
    return int(json.loads(counts.read_text())["messages"]) if counts.exists() else 0


def run_node(endpoint: str, counts: Path) -> None:
    """Be the router and a subscriber of all topics; at the end write what arrived."""
    config = zenoh.Config()
    settings = {
        "mode": "router",
        "listen/endpoints": [endpoint],
        "scouting/multicast/enabled": False,
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    seen: dict[str, list[int]] = {}
    span_ns = [0, 0]

    def receive(sample: zenoh.Sample) -> None:
        number = int.from_bytes(sample.attachment.to_bytes()[:8], "little")
        seen.setdefault(str(sample.key_expr), []).append(number)
        span_ns[0], span_ns[1] = span_ns[0] or now_ns(), now_ns()

    with zenoh.open(config) as opened:
        _subscriber = opened.declare_subscriber("0/**", receive)
        while True:
            time.sleep(0.5)
            numbers = [some.copy() for some in list(seen.values())]
            summary = {
                "topics": len(numbers),
                "messages": sum(map(len, numbers)),
                "lost": sum(some[-1] - some[0] + 1 - len(some) for some in numbers),
                "seconds": (span_ns[1] - span_ns[0]) * 1e-9,
            }
            write_text_file(counts, json.dumps(summary), "the counts")


if __name__ == "__main__":
    main()
