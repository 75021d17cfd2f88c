"""How long `teleop stop` takes while strangers keep both ports busy, and while nobody does.

python studies/stop.py [--count 200] [--set rate_hz=250]

The time is that of the whole command, until it has printed that both sides have stopped, without a
flood (the baseline) and under one of silent connections and failing TLS at each port. After each
stop it is reset. Beside it is the time of a Python that does nothing, and that of a Python with the
modules of a stop over the network. Modules are compiled beforehand, as in an installed package.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from contextlib import nullcontext
from pathlib import Path

import numpy as np

from studies.testbed.processes import Processes
from studies.testbed.strangers import FAILING_HZ, SILENT, flooded
from teleop.remote.stop_socket import request_local

CONFIG = Path(__file__).parent.parent / "configs" / "demo.yaml"


COMPILED = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
NOTHING = ["-c", "pass"]
NETWORK = ["-c", "import teleop.remote.stop_over_link"]
NETWORK_EVERY = 10  # it takes long


def seconds_of(words: list[str]) -> tuple[float, list[str]]:
    """Return how long a Python of these words took [s], and the words that it printed."""
    begin = time.monotonic()
    done = subprocess.run(
        [sys.executable, *words], env=COMPILED, capture_output=True, text=True, check=False
    )
    return time.monotonic() - begin, done.stdout.split()


def measure(session: Processes, count: int) -> tuple[dict[str, list[float]], int]:
    """Return how long each command took [s], and how many stops did not end well."""
    times: dict[str, list[float]] = {"teleop stop": [], "nothing": [], "network": []}
    failed = 0
    for index in range(count):
        seconds, words = seconds_of(["-m", "teleop", "stop", "--session", session.session])
        failed += words[1::2] != ["stopped"] * 2
        times["teleop stop"].append(seconds)
        times["nothing"].append(seconds_of(NOTHING)[0])
        if index % NETWORK_EVERY == 0:
            times["network"].append(seconds_of(NETWORK)[0])
        request_local(session.session, is_reset=True, reason="")
    return times, failed


def main() -> int:
    """Print all; returns 1 if a stop failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument(
        "--set", dest="overrides", action="append", default=[], metavar="KEY=VALUE",
        help="of the config: rate_hz=250 where a session at 1 kHz leaves commands no processor",
    )  # fmt: skip
    args = parser.parse_args()
    count, failures = args.count, 0
    with (
        tempfile.TemporaryDirectory() as folder,
        Processes(Path(folder), CONFIG, *args.overrides) as session,
    ):
        session.start_all()
        ports = [session.link_config.master, session.link_config.slave]
        flood = f"{SILENT} silent connections, {FAILING_HZ:g} failing ones a second at each port"
        for name, strangers in (("nobody", nullcontext()), (flood, flooded(ports))):
            with strangers:
                times, failed = measure(session, count)
            failures += failed
            print(f"{name}: {failed} of {count} stops failed")
            for what, taken in times.items():
                p50, p99 = np.percentile(taken, [50, 99])
                print(f"  {what}: p50 {p50:.3f} s, p99 {p99:.3f} s, max {max(taken):.3f} s")
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
