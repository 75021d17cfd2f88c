"""Do harm to a running session again and again, and measure from recordings how it took it.

    python -m studies.faults.campaign                   216 faults: 8 of a sort, half an hour
    python -m studies.faults.campaign --sessions 2 --load 2    two at a time, on a busy machine
    python -m studies.faults.campaign --rounds 2 --out /tmp/faults --json faults.json
    python -m studies.faults.campaign --judge /tmp/faults         look again at what was recorded

Ends with exit code 1 unless the 99th percentile of the slave's reaction is within `SLAVE_S` and a
tick, every reaction of the master within `MASTER_S`, and nothing moved or engaged unasked.
"""

import argparse
import contextlib
import json
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import repeat
from pathlib import Path

import numpy as np

from studies.faults.judge import CampaignResult, judge
from studies.faults.session import (
    DEMO_CONFIG,
    PLAN,
    Fault,
    FaultSession,
    inject,
    may_end_engagement,
)
from studies.testbed.processes import pause

FAULTS = "faults.json"
SLAVE_S, MASTER_S = 0.030, 0.050  # [s] after the last fresh message
AFTERMATH_S = 4.0  # [s] in which messages that a fault lost may hold a later engagement


def harm(bench: FaultSession, plan: list[tuple[str, str]], rng: np.random.Generator, say=print):
    """Inject the faults of a plan, each into a session that is engaged; return them."""
    faults: list[Fault] = []
    for number, (kind, target) in enumerate(plan):
        if faults and faults[-1].disturbs and not may_end_engagement(kind, target):
            pause(AFTERMATH_S)
        while True:
            bench.await_engaged()
            pause(float(rng.uniform(0.1, 0.6)))
            if bench.engaged(bench.link):  # and no stall of the machine was a fault of its own
                break
        faults.append(inject(bench, kind, target, rng))
        say(f"{number + 1}/{len(plan)} {faults[-1].name} {faults[-1].seconds:.2f} s", flush=True)
    bench.await_engaged()
    pause(0.5)
    return faults


def summarise(verdict: CampaignResult) -> dict:
    """Return the figures of a campaign."""
    by_side, by_fault = defaultdict(list), defaultdict(list)
    for fault, side, seconds in verdict.reactions:
        by_side[side].append(seconds)
        by_fault[f"{side} after {fault.name}"].append(seconds)
    return {
        "reactions_ms": {
            side: {
                "n": len(values),
                "p50": 1e3 * float(np.median(values)),
                "p99": 1e3 * float(np.percentile(values, 99)),
                "max": 1e3 * max(values),
            }
            for side, values in by_side.items()
        },
        "by_fault_ms": {
            name: [round(1e3 * seconds, 1) for seconds in sorted(values)]
            for name, values in sorted(by_fault.items())
        },
        "longest_act_in_silence_ms": {side: 1e3 * s for side, s in verdict.worst.items()},
        "finished_late": verdict.finished_late,
        "engagements": verdict.engagements,
        "engaged_unasked": verdict.engaged_unasked,
        "followed_nobody": verdict.followed_nobody,
        "pulled_in_m": verdict.pulled_in,
        "let_out_m": verdict.let_out,
        "broken_off": verdict.broken_off,
    }


def failures(verdict: CampaignResult, faults: list[Fault]) -> list[str]:
    """Return what a session must not have done, or what was not seen of it."""
    out = []
    concerned = sum(fault.concerns(side) for fault in faults for side in ("master", "slave"))
    if len(verdict.reactions) < concerned / 2:
        out.append(f"only {len(verdict.reactions)} of {concerned} reactions were seen")
    if verdict.engagements < len(faults) / 2:
        out.append(f"only {verdict.engagements} engagements for {len(faults)} faults")
    if max(verdict.worst.values()) > MASTER_S:
        out.append("a side acted in a long silence")
    times = {
        side: [seconds for _, name, seconds in verdict.reactions if name == side]
        for side in ("master", "slave")
    }
    if times["slave"] and np.percentile(times["slave"], 99) > SLAVE_S + verdict.tick:
        out.append("the slave held late")
    if times["master"] and max(times["master"]) > MASTER_S:
        out.append("the master's force was zero late")
    if verdict.engaged_unasked or verdict.followed_nobody:
        out.append("a side engaged unasked")
    if verdict.broken_off:
        out.append("an engagement ended by the fault of a bystander")
    if verdict.pulled_in > 0.0 or verdict.let_out > 0.0:
        out.append("motors moved while not engaged")
    return out


def run_session(
    folder: Path, plan: list[tuple[str, str]], rng: np.random.Generator, overrides: list[str]
) -> dict:
    """Do the harm of a plan to a session that records into `folder`; return the figures."""
    folder.mkdir(parents=True, exist_ok=True)
    extra = ["view"] * any(target == "view" for _, target in plan)
    with FaultSession(folder, DEMO_CONFIG, *overrides, extra=extra) as bench:
        faults = harm(bench, plan, rng, partial(print, f"{folder.name}:"))
        bench.end()
    (folder / FAULTS).write_text(json.dumps(faults))
    return judge_session(folder)


def judge_session(folder: Path) -> dict:
    """Return the figures of a session from its recordings."""
    faults = [Fault(*one) for one in json.loads((folder / FAULTS).read_text())]
    verdict = judge(sorted(folder.glob("*.mcap")), faults)
    return {"faults": len(faults), **summarise(verdict), "failures": failures(verdict, faults)}


@contextlib.contextmanager
def busy(processes: int) -> Iterator[None]:
    """Keep processors busy with so many processes of ordinary priority."""
    words = [sys.executable, "-c", "while True: pass"]
    running = [subprocess.Popen(words) for _ in range(processes)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def build_parser(description: str, kinds: list[str]) -> argparse.ArgumentParser:
    """Return a parser of what all runs with faults have in common."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--kinds", nargs="+", default=kinds)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--set", dest="overrides", action="append", default=[], metavar="KEY=VALUE",
        help="of the config, e.g. rate_hz=500 on a busy machine",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, help="folder for recordings and logs")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    return parser


def publish(figures: dict, path: Path | None) -> None:
    """Print the figures, and write them to a file."""
    text = json.dumps(figures, indent=2)
    print(text)
    if path is not None:
        path.write_text(text + "\n")


def main():
    parser = build_parser(__doc__, sorted({kind for kind, _ in PLAN}))
    parser.add_argument("--rounds", type=int, default=8, help="of one fault of each kind")
    parser.add_argument("--sessions", type=int, default=1, help="at the same time")
    parser.add_argument("--load", type=int, default=0, help="busy processes beside them")
    parser.add_argument("--judge", type=Path, help="folder of an earlier campaign")
    args = parser.parse_args()
    chosen = [one for one in PLAN if one[0] in args.kinds]
    with tempfile.TemporaryDirectory() as scratch:
        folder = args.judge or args.out or Path(scratch)
        folders = [folder / f"session-{k}" for k in range(args.sessions)]
        if args.judge:
            results = list(map(judge_session, folders))
        else:
            rngs = [np.random.default_rng([args.seed, k]) for k in range(args.sessions)]
            plans = [
                [chosen[i] for _ in range(args.rounds) for i in rng.permutation(len(chosen))]
                for rng in rngs
            ]
            with busy(args.load), ThreadPoolExecutor(args.sessions) as pool:
                results = list(pool.map(run_session, folders, plans, rngs, repeat(args.overrides)))
    publish({"seed": args.seed, "load": args.load, "sessions": results}, args.json)
    return any(one["failures"] for one in results)


if __name__ == "__main__":
    sys.exit(main())
