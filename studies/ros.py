"""What `teleop ros` does to the loops, what it costs, and what arrives at a ROS node.

  python studies/ros.py [SECONDS [ROUNDS]]     8 s of each state, 3 rounds

One session runs while `teleop ros` is, in turn, absent, there at 100 Hz and there at 250 Hz, with a
router and a subscriber of all topics in a process of their own. A recorder beside it tells the
period of both loops and the way from command to force in each state; all meet the same machine.
"""

import json
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import zenoh
from view import CONFIG, Spans, end, report, wait_until_engaged

from studies.testbed.processes import processor_s
from teleop.runtime.clock import now_ns
from teleop.runtime.process import write_text_file
from teleop.view.local_server import find_free_port

SETTLE_S = 4.0  # [s] after a change of state that are not counted
PATIENCE_S = 60.0
LEAST = 100  # messages that have arrived when a measurement begins
RATES_HZ = (100, 250)


def main(*words: str) -> None:
    if words and words[0] == "node":
        node(words[1], Path(words[2]))
        return
    seconds, rounds = (*map(float, words), *(8.0, 3.0)[len(words) :])
    with tempfile.TemporaryDirectory(prefix="ros-benchmark-") as folder:
        recording, spans = session(Path(folder), seconds, int(rounds))
        report(recording, spans, "ros")


def session(folder: Path, seconds: float, rounds: int) -> tuple[Path, Spans]:
    """Run a session, with and without `teleop ros`; return its recording and when was what."""
    shared = ["--config", str(CONFIG), "--set", "session=ros-benchmark"]
    for side in ("master", "slave"):
        shared += ["--set", f"link.{side}=127.0.0.1:{find_free_port(0)}"]
    router, counts = f"tcp/127.0.0.1:{find_free_port(0)}", folder / "counts.json"
    spans: Spans = {"off": []} | {f"{rate} Hz": [] for rate in RATES_HZ}

    with ExitStack() as stack:

        def start(*words: str) -> "subprocess.Popen[bytes]":
            process = subprocess.Popen(
                [sys.executable, *words], stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT
            )
            stack.callback(end, process)
            return process

        def measured(state: str) -> None:
            time.sleep(SETTLE_S)
            begin = now_ns()
            time.sleep(seconds)
            spans[state].append((begin, now_ns()))

        start("-m", "teleop", "record", *shared, "--out", str(folder))
        start("-m", "teleop", "slave", *shared)
        start("-m", "teleop", "master", *shared)
        wait_until_engaged(shared[3::2])
        for _ in range(rounds):
            measured("off")
            for rate in RATES_HZ:
                counts.unlink(missing_ok=True)
                listener = start(__file__, "node", router, str(counts))
                settings = (f"ros.router={router}", f"ros.rate_hz={rate}")
                words = [word for setting in settings for word in ("--set", setting)]
                shown = start("-m", "teleop", "ros", *shared, *words)
                wait_for_messages(counts)
                before, at_s = processor_s(shown.pid), time.monotonic()
                measured(f"{rate} Hz")
                used = (processor_s(shown.pid) - before) / (time.monotonic() - at_s)
                end(shown)
                end(listener)
                heard = json.loads(counts.read_text())
                total = heard["messages"] / heard["seconds"]
                print(
                    f"{rate} Hz: {total:.0f} messages a second on {heard['topics']} topics, "
                    f"{heard['lost']} lost; {100 * used:.1f} % of a core",
                    flush=True,
                )
    (path,) = folder.glob("*.mcap")
    return path, spans


def node(endpoint: str, counts: Path) -> None:
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

    with zenoh.open(config) as opened, suppress(KeyboardInterrupt):
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


def wait_for_messages(counts: Path) -> None:
    """Wait until enough has arrived at the node to be counted."""
    patience = time.monotonic() + PATIENCE_S
    while time.monotonic() < patience:
        time.sleep(0.2)
        if counts.exists() and json.loads(counts.read_text())["messages"] > LEAST:
            return
    raise SystemExit("nothing arrived at the ROS node")


if __name__ == "__main__":
    main(*sys.argv[1:])
