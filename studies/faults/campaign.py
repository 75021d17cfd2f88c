"""Do harm to a running session again and again, and measure from recordings how it took it.

    python -m studies.faults.campaign               208 faults, 8 of a sort: half an hour
    python -m studies.faults.campaign --rounds 2 --out /tmp/faults
    python -m studies.faults.campaign --judge /tmp/faults     look again at what was recorded

Ends with exit code 1 unless the 99th percentile of the slave's reaction is within `SLAVE_S` and a
tick, every reaction of the master within `MASTER_S`, and nothing moved or engaged unasked. Some
faults need root (a memory cgroup) or a C compiler (a wall clock that can be set).
"""

import json
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

import numpy as np

from studies.faults.injection import PLAN, Fault, inject_fault, may_end_engagement
from studies.faults.judge import CampaignResult, judge_recordings
from studies.faults.session import FaultSession
from studies.testbed.command import parse_options
from studies.testbed.processes import DEMO_CONFIG, pause

FAULTS = "faults.json"
SLAVE_S, MASTER_S = 0.030, 0.050  # [s] after the last fresh message
AFTERMATH_S = 4.0  # [s] in which messages that a fault lost may hold a later engagement


def inject_faults(bench: FaultSession, plan: list[tuple[str, str]], rng: np.random.Generator):
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
        faults.append(inject_fault(bench, kind, target, rng))
        print(f"{number + 1}/{len(plan)} {faults[-1].name} {faults[-1].seconds:.2f} s", flush=True)
    bench.await_engaged()
    pause(0.5)
    return faults


def summarise_campaign(verdict: CampaignResult) -> dict:
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


def list_failures(verdict: CampaignResult, faults: list[Fault]) -> list[str]:
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


def run_session(folder: Path, plan: list[tuple[str, str]], rng: np.random.Generator, overrides):
    """Do the harm of a plan to a session that records into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    extra = ["view"] * any(target == "view" for _, target in plan)
    with FaultSession(folder, DEMO_CONFIG, *overrides, extra=extra) as bench:
        faults = inject_faults(bench, plan, rng)
        bench.end()
    (folder / FAULTS).write_text(json.dumps(faults))


def judge_session(folder: Path) -> dict:
    """Return the figures of a session from its recordings."""
    faults = [Fault(*row) for row in json.loads((folder / FAULTS).read_text())]
    verdict = judge_recordings(sorted(folder.glob("*.mcap")), faults)
    return {
        "faults": len(faults),
        **summarise_campaign(verdict),
        "failures": list_failures(verdict, faults),
    }


def main() -> int:
    """Return the exit code."""
    args = parse_options(
        __doc__,
        kinds=(tuple(sorted({kind for kind, _ in PLAN})), "of fault"),
        rounds=(8, "of one fault of each kind"),
        seed=(1, "of their order and times"),
        set=("rate_hz=1000", "KEY=VALUE of the config; less on a busy machine"),
        out=(Path, "folder for recordings and logs"),
        judge=(Path, "folder of an earlier campaign"),
    )
    chosen = [fault for fault in PLAN if fault[0] in args.kinds]
    rng = np.random.default_rng([args.seed, 0])
    with tempfile.TemporaryDirectory() as scratch:
        folder = args.judge or args.out or Path(scratch)
        if not args.judge:
            plan = [chosen[i] for _ in range(args.rounds) for i in rng.permutation(len(chosen))]
            run_session(folder, plan, rng, [args.set])
        figures = judge_session(folder)
    print(json.dumps({"seed": args.seed} | figures, indent=2))
    return bool(figures["failures"])


if __name__ == "__main__":
    sys.exit(main())
