"""A long session on a bad network, a fault every few seconds: leaks, are the counters correct?

    python -m studies.faults.soak --seconds 600

Nothing is killed here, so that memory and counters are those of one life. Ends with exit code 1 if
a process ended or grew, if the counters of a side do not agree with what the proxy did to its
messages, or if anything moved or engaged that was not asked to.
"""

import json
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from studies.faults.campaign import build_parser, failures, publish, summarise
from studies.faults.judge import FRESH_NS, judge
from studies.faults.session import DEMO_CONFIG, NAMES, PLAN, Fault, FaultSession, inject
from studies.testbed.processes import pause, resident_mb

NETWORK = {
    "delay": 0.003, "jitter": 0.002, "loss": 0.02, "burst_loss": 0.005, "burst_length": 3.0,
    "reorder": 0.01, "duplicate": 0.02, "corrupt": 0.01,
}  # fmt: skip
LATE_NS = round((NETWORK["delay"] + NETWORK["jitter"] + 0.003) * 1e9)  # what the network adds
GROWTH = 4.0  # [MB] a process may grow by between the second quarter and the last
STOPPED = 50  # messages that may be dropped unseen around each stop of a process


def memory_mb(bench: FaultSession) -> dict[str, float]:
    """Return the resident memory of each process."""
    return {name: resident_mb(bench.running[name].pid) for name in NAMES}


def live(bench: FaultSession, seconds: float, rng: np.random.Generator, kinds: list[str]):
    """Let a session live for some time; return its faults and its memory over time."""
    plan = [one for one in PLAN if one[0] in kinds]
    faults, sizes = list[Fault](), []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        bench.await_engaged()
        pause(float(rng.uniform(0.2, 1.5)))
        sizes.append(memory_mb(bench))
        faults.append(inject(bench, *plan[rng.integers(len(plan))], rng))
        print({name: round(mb, 1) for name, mb in sizes[-1].items()}, faults[-1].name, flush=True)
    bench.await_engaged()
    pause(0.5)
    return faults, sizes


def growth(sizes: list[dict[str, float]]) -> dict[str, float]:
    """Return by how much [MB] each process grew from the second quarter to the last."""
    quarter = max(len(sizes) // 4, 1)
    early, late = sizes[quarter : 2 * quarter] or sizes, sizes[-quarter:]
    return {
        name: float(np.median([s[name] for s in late]) - np.median([s[name] for s in early]))
        for name in NAMES
    }


def books(side: dict, way: dict, stops: int) -> list[tuple[str, int, int, int]]:
    """Return (what, counted by the side, to be expected of the proxy, tolerance) for one direction.

    Messages that are both corrupted and doubled, or whose copy is overtaken, are in one column or
    another by chance; those dropped by a full queue while somebody stands still, in none.
    """
    rejected = Counter(side["rejected"])
    unseen = side["overwritten"] + STOPPED * (1 + stops)
    twice = way["corrupted"] * way["duplicated"] // max(way["came"], 1)
    chance = 30 + 3 * twice + round(4 * twice**0.5)
    gone = way["cut"] + way["lost"] + way["lost_in_bursts"]
    return [
        ("let in or rejected", side["received"] + sum(rejected.values()), way["sent"], unseen),
        (
            "corrupted",
            rejected["corrupted"] + rejected["layout"],
            way["corrupted"] + twice,
            chance + unseen // 20,
        ),
        (
            "repeated or out of order",
            rejected["repeated"] + rejected["out_of_order"],
            way["duplicated"] - twice + way["held_back"],
            chance + unseen // 20 + way["held_back"] // 10,
        ),
        (
            "missing",
            side["lost"] + side["overwritten"],
            gone + way["corrupted"] + way["held_back"] + side["overwritten"],
            unseen + chance + way["held_back"] // 10,
        ),
    ]


def main():
    parser = build_parser(__doc__, ["stop", "cut", "unplug"])
    parser.add_argument("--seconds", type=float, default=600.0)
    args = parser.parse_args()
    words = [
        f"impair.{way}.{k}={v}" for way in ("to_slave", "to_master") for k, v in NETWORK.items()
    ]
    with tempfile.TemporaryDirectory() as scratch:
        folder = args.out or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        with FaultSession(folder, DEMO_CONFIG, *words, *args.overrides) as bench:
            faults, sizes = live(bench, args.seconds, np.random.default_rng(args.seed), args.kinds)
            bench.end()
        ends = {name: json.loads((folder / f"{name}-0.json").read_text()) for name in NAMES[1:]}
        verdict = judge(bench.recordings(), faults, FRESH_NS + LATE_NS)
    stops = sum(fault.kind == "stop" for fault in faults)
    counters = {
        side: books(ends[side], ends["impair"][f"to_{side}"][topic], stops)
        for side, topic in (("slave", "command"), ("master", "state"))
    }
    grown = growth(sizes)
    wrong = failures(verdict, faults)
    wrong += [f"{name} grew by {mb:.1f} MB" for name, mb in grown.items() if mb > GROWTH]
    wrong += [
        f"{side}: {what}: {counted}, expected {expected} +- {slack}"
        for side, rows in counters.items()
        for what, counted, expected, slack in rows
        if abs(counted - expected) > slack
    ]
    figures = {
        "seconds": args.seconds,
        "faults": Counter(fault.name for fault in faults),
        "memory_growth_mb": grown,
        "memory_at_start_mb": {name: round(mb, 1) for name, mb in sizes[0].items()},
        "memory_at_end_mb": {name: round(mb, 1) for name, mb in sizes[-1].items()},
        "memory_mb": {
            name: [round(s[name], 1) for s in sizes[:: max(len(sizes) // 20, 1)]] for name in NAMES
        },
        "counters": counters,
        "proxy": ends["impair"],
        "failures": wrong,
    } | summarise(verdict)
    publish(figures, args.json)
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
