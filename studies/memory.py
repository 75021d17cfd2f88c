"""How much the recorder or the proxy grows when it is stopped and its queues fill up.

python -m studies.memory [--proxy] [--stops 12] [--seconds 1.0]

Two sides publish four topics at 1 kHz each. The program is stopped (SIGSTOP) and continued again
and again; its resident memory is printed after each time, and what it counted at the end. Takes
half a minute.
"""

import json
import signal
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path

from studies.testbed.command import parse_options
from studies.testbed.processes import find_free_ports, read_memory_mb
from teleop.link import Link, LinkConfig
from teleop.messages.topics import COMMAND, HAND, STATE, TENDONS, Role
from teleop.runtime.child_process import end_process, start_module

SESSION = "benchmark-memory"
PERIOD_S = 1e-3


def publish(slave: Link, master: Link, published: Counter, stopping: threading.Event) -> None:
    """Publish on a grid until told to stop."""
    begin, tick = time.monotonic(), 0
    while not stopping.is_set():
        tick += 1
        for link, topic in ((master, COMMAND), (slave, STATE), (slave, TENDONS), (master, HAND)):
            link.publish(topic, topic.message())
            published[topic.name] += 1
        time.sleep(max(0.0, begin + tick * PERIOD_S - time.monotonic()))


def main() -> None:
    args = parse_options(
        __doc__,
        proxy=(False, "the proxy of `teleop impair` in place of the recorder"),
        stops=(12, "number of stops"),
        seconds=(1.0, "that each stop lasts"),
    )
    program = "impair" if args.proxy else "record"
    a, b, c = (f"127.0.0.1:{port}" for port in find_free_ports(3))
    shared = LinkConfig(master=a, slave=b)
    words = [f"session={SESSION}", f"link.master={a}", f"link.slave={b}"]
    published: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        summary = Path(folder) / "summary.json"
        if args.proxy:
            words += [f"impair.endpoint={c}"]
            words += [f"impair.{way}.delay=0.003" for way in ("to_slave", "to_master")]
        command = [program, "--json", str(summary), *(() if args.proxy else ("--out", folder))]
        settings = [f"--set={word}" for word in words]
        process = start_module("teleop", *command, *settings, is_supervised=True)
        config = LinkConfig(master=a, slave=c) if args.proxy else shared
        try:
            time.sleep(2.0)
            with (
                Link(shared, SESSION, Role.SLAVE) as slave,
                Link(config, SESSION, Role.MASTER) as master,
            ):
                slave.subscribe_latest(COMMAND)
                master.subscribe_latest(STATE)
                stopping = threading.Event()
                thread = threading.Thread(target=publish, args=(slave, master, published, stopping))
                thread.start()
                time.sleep(3.0)
                sizes = [read_memory_mb(process.pid)]
                for _ in range(args.stops):
                    process.send_signal(signal.SIGSTOP)
                    time.sleep(args.seconds)
                    process.send_signal(signal.SIGCONT)
                    time.sleep(1.0)
                    sizes.append(read_memory_mb(process.pid))
                stopping.set()
                thread.join()
                time.sleep(0.5)
        finally:
            end_process(process, 10.0)
        counted = json.loads(summary.read_text())
    print(f"{program}: resident memory [MB] at first and after each stop:")
    print("  " + " ".join(f"{size:.1f}" for size in sizes))
    print(f"published {dict(published)}")
    wanted = ("messages", "gaps", "dropped", "to_slave", "to_master")
    print(json.dumps({name: counted[name] for name in wanted if name in counted}))


if __name__ == "__main__":
    main()
