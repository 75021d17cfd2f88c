"""How exact the delay of `teleop impair` is: what it adds, beside the same messages sent directly.

python -m studies.impair

3000 messages for each delay, one a millisecond. Takes 20 s.
"""

import time

import numpy as np

from studies.testbed.command import parse_options
from studies.testbed.processes import find_free_ports, tell_proxy
from teleop.link import Link, LinkConfig
from teleop.messages.messages import Command
from teleop.messages.topics import COMMAND, Role
from teleop.runtime.child_process import end_process, start_module

DELAYS = (0.0, 0.01, 0.05, 0.1)  # [s]
COUNT = 3000  # messages for each, one a millisecond
SESSION = "benchmark-impair"


def measure_latencies(
    config: LinkConfig, shared: LinkConfig, delay: float, proxied: bool
) -> np.ndarray:
    """Return how long each message took [s]."""
    with Link(shared, SESSION, Role.SLAVE) as slave, Link(config, SESSION, Role.MASTER) as master:
        listener = slave.listen((COMMAND,))
        if proxied:
            delays = (f"{way}.delay={delay}" for way in ("to_slave", "to_master"))
            tell_proxy(config, SESSION, config.slave, "set", *delays)
        time.sleep(0.5)
        begin = time.monotonic()
        for k in range(COUNT):
            time.sleep(max(0.0, begin + k * 1e-3 - time.monotonic()))
            master.publish(COMMAND, Command())
        time.sleep(delay + 0.3)
        messages = listener.drain()
    return np.array([item.received_ns - item.stamp_ns for item in messages]) * 1e-9


def main() -> None:
    parse_options(__doc__)
    a, b, c = (f"127.0.0.1:{port}" for port in find_free_ports(3))
    shared, config = LinkConfig(master=a, slave=b), LinkConfig(master=a, slave=c)
    print("Added by the proxy, over what was asked for [ms]; one message a millisecond")
    direct = measure_latencies(shared, shared, 0.0, proxied=False) * 1e3
    print(f"{'direct':>10}   p50 {np.median(direct):6.3f}   p99 {np.percentile(direct, 99):6.3f}")
    words = [f"session={SESSION}", f"link.master={a}", f"link.slave={b}", f"impair.endpoint={c}"]
    settings = [f"--set={word}" for word in words]
    proxy = start_module("teleop", "impair", *settings, is_supervised=True)
    try:
        for delay in DELAYS:
            over = (measure_latencies(config, shared, delay, proxied=True) - delay) * 1e3
            print(
                f"{1e3 * delay:7.0f} ms   p50 {np.median(over):6.3f}   "
                f"p99 {np.percentile(over, 99):6.3f}   max {over.max():6.3f}   n {len(over)}"
            )
    finally:
        end_process(proxy, 10.0)


if __name__ == "__main__":
    main()
