"""Emulate an impaired network between master and slave: delay, loss, corruption, cuts; seeded.

  teleop impair --delay 0.1 --jitter 0.05 --loss 0.1   in both directions
  teleop impair --config experiment.yaml     with its `impair` section
  teleop run --config demo.yaml --set impair.to_slave.delay=0.1   in a session
  teleop impair cut; teleop impair mend      block or unblock all messages of a running proxy
  teleop impair set to_slave.loss=0.3        change a setting of a running proxy
  teleop impair status                       counts of delayed and lost messages

`teleop run` gives the master the proxy's endpoint; start a separate master with
`teleop master --set link.slave=127.0.0.1:7449`. Recorder and viewer receive from both sides
directly: a recording has the messages as sent.
"""

import argparse
import dataclasses
import json
import sys
import time
from contextlib import ExitStack
from typing import Any, get_type_hints

from teleop.config.loading import ConfigDocument
from teleop.config.options import add_options
from teleop.config.overrides import Override
from teleop.errors import UsageError
from teleop.impair.config import DirectionConfig, ImpairConfig
from teleop.impair.direction import WAIT_S, DelayQueue, Direction
from teleop.link.bridge import BridgeEnd, send_request
from teleop.runtime.clock import pause_garbage_collection
from teleop.runtime.process import StopCondition, is_supervised, write_summary
from teleop.runtime.realtime import limit_computing_time, request_realtime, share_heaps
from teleop.session.config import RunConfig, read_config
from teleop.session.summary import format_impair_counts

DIRECTIONS = ("to_slave", "to_master")
ACTIONS = ("cut", "mend", "set", "status")
_SWITCH_S = 0.0005  # switch interval of our threads; Python's default is 5 ms
_NUMERIC_OPTIONS = tuple(
    name for name, hint in get_type_hints(DirectionConfig).items() if hint is float
)
_HELP = {  # metavar and help of each number
    "delay": ("S", "mean delay of a message [s]"),
    "jitter": ("S", "the delay varies from delay - jitter to delay + jitter [s]"),
    "jitter_time": (
        "S",
        "time between random delays, linear in between [s]; 0 = a new one for each message",
    ),
    "loss": ("SHARE", "share of messages lost independently, 0 to 1"),
    "burst_loss": ("SHARE", "share of messages lost in bursts, 0 to 1"),
    "burst_length": ("N", "mean length of a burst [messages]"),
    "burst_depth": ("SHARE", "share of messages lost during a burst, above 0 to 1"),
    "reorder": ("SHARE", "share of messages held back so that others overtake them, 0 to 1"),
    "reorder_by": ("S", "additional delay of those messages [s]"),
    "duplicate": ("SHARE", "share of messages duplicated, 0 to 1"),
    "corrupt": ("SHARE", "share of messages with one byte changed, 0 to 1"),
    "cut_period": ("S", "period after which the config's `cuts` repeat [s]"),
}


class Proxy:
    """The two banks, the two directions between them, and the delay queue.

    `document` is the session's config, with the section `impair`.
    """

    def __init__(self, shared: RunConfig, document: ConfigDocument) -> None:
        self._document = document
        self._queue = DelayQueue()
        config = document.load(ImpairConfig, "impair")
        self._look_ns = 0  # time of the next check of the banks
        self._stack = ExitStack()
        with ExitStack() as opening:
            link = config.build_link_config(shared.link)
            master = BridgeEnd(link, shared.session, [config.endpoint], [], self._look_soon)
            opening.callback(master.close)
            slave = BridgeEnd(shared.link, shared.session, [], [shared.link.slave], self._look_soon)
            opening.callback(slave.close)
            master.pass_challenges_to(slave)
            slave.pass_challenges_to(master)
            self._stack = opening.pop_all()
        ends = {"to_slave": (master, slave), "to_master": (slave, master)}
        self._directions = {
            name: Direction(name, getattr(config, name), config.seed, *ends[name], self._queue)
            for name in DIRECTIONS
        }
        self._presence_s = config.presence
        master.serve(self.answer)

    def close(self) -> None:
        """Close both sides; messages in the queue are lost."""
        self._stack.close()

    def send_due(self) -> None:
        """Do the work that is due; returns within some 20 ms."""
        self._queue.send_due()
        now = time.monotonic_ns()
        if now >= self._look_ns:
            self._look_ns = now + round(WAIT_S * 1e9)
            for direction in self._directions.values():
                direction.mirror(self._presence_s)

    def answer(self, request: str) -> dict[str, Any]:
        """Execute `teleop impair ACTION`, and return the counts."""
        action, *words = request.split("\n")
        if action in ("cut", "mend"):
            if not set(words) <= set(DIRECTIONS):
                raise UsageError(
                    f"{action}: {' '.join(words)}: allowed are {', '.join(DIRECTIONS)}"
                )
            for name in words or DIRECTIONS:
                self._directions[name].cut = action == "cut"
        elif action == "set":
            self._set(words)
        elif action != "status":
            raise UsageError(f"{action}: allowed are {', '.join(ACTIONS)}")
        return self.count_messages()

    def count_messages(self) -> dict[str, Any]:
        """Return the message counts of each direction, and the lateness of the queue."""
        counts = {name: direction.count_messages() for name, direction in self._directions.items()}
        return counts | {
            "waiting": len(self._queue),
            "waiting_bytes": self._queue.held_bytes,
            "lateness_us": dataclasses.asdict(self._queue.lateness.compute_percentiles(1e-3)),
        }

    def _look_soon(self) -> None:
        self._look_ns = 0
        self._queue.wake()

    def _set(self, words: list[str]) -> None:
        if not words:
            raise UsageError("set: KEY=VALUE is missing, such as to_slave.loss=0.3")
        fixed = [
            word for word in words if not word.startswith(tuple(f"{way}." for way in DIRECTIONS))
        ]
        if fixed:
            raise UsageError(f"{fixed[0]}: allowed are to_slave.KEY=VALUE and to_master.KEY=VALUE")
        document = self._document.override(*(Override.parse(f"impair.{word}") for word in words))
        config = document.load(ImpairConfig, "impair")
        self._document = document
        for name, direction in self._directions.items():
            direction.configure(getattr(config, name))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop impair`."""
    add_options(parser, "--session", "--config", "--set", "--insecure", "--duration", "--json")
    parser.add_argument(
        "action",
        nargs="*",
        metavar="ACTION",
        help=(
            "control the running proxy: cut | mend [to_slave|to_master] (both without one), "
            "set KEY=VALUE ..., status"
        ),
    )
    group = parser.add_argument_group(
        "both ways",
        "initial values of `impair.to_slave` and `impair.to_master`, in place of the config's",
    )
    for item in dataclasses.fields(DirectionConfig):
        if item.name in _NUMERIC_OPTIONS:
            option = f"--{item.name.replace('_', '-')}"
            metavar, text = _HELP[item.name]
            group.add_argument(option, dest=item.name, type=float, metavar=metavar, help=text)
    parser.add_argument("--seed", type=int, metavar="N", help="seed of the random numbers")


def main(args: argparse.Namespace) -> int:
    """Run the proxy, or control the running one; returns the exit code."""
    document = read_config(args, join=bool(args.action))
    document = dataclasses.replace(
        document, overrides=(*build_overrides(args), *document.overrides)
    )
    shared, config = document.load(RunConfig), document.load(ImpairConfig, "impair")
    config.require_direct(shared.link)
    if args.action:
        link = config.build_link_config(shared.link)
        answer = send_request(link, shared.session, config.endpoint, "\n".join(args.action))
        print(json.dumps(answer, indent=2))
        return 0
    stop = StopCondition(args.duration)
    share_heaps()
    # before the link: its threads inherit the priority
    granted = request_realtime(shared.realtime)
    sys.setswitchinterval(_SWITCH_S)
    proxy = Proxy(shared, document)
    limit_computing_time(granted)
    try:
        if not is_supervised():
            print(f"the master connects to the slave at {config.endpoint} now", flush=True)
        with pause_garbage_collection():
            while not stop():
                proxy.send_due()
    finally:
        counts = proxy.count_messages()
        proxy.close()
    write_summary(args.json, counts | {"stopped": stop.reason, "realtime": granted})
    if not is_supervised():
        print("\n".join(format_impair_counts(counts)))
    return 0


def build_overrides(args: argparse.Namespace) -> list[Override]:
    """Return the options of the command line as overrides."""
    out = [Override.from_value("impair.seed", args.seed)] if args.seed is not None else []
    for name in _NUMERIC_OPTIONS:
        value = getattr(args, name)
        if value is not None:
            out += [
                Override.from_value(f"impair.{direction}.{name}", value) for direction in DIRECTIONS
            ]
    return out
