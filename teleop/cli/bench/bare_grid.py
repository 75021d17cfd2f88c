"""The baseline of a loop: idle processes that tick at its rate and priority."""

import json
import subprocess
import sys
import time
from dataclasses import asdict
from typing import Any

from teleop.runtime.child_process import start_module
from teleop.runtime.clock import Durations, Grid, now_ns, pause_garbage_collection
from teleop.runtime.process import StopCondition, die_with_launcher, limit_numeric_threads
from teleop.runtime.realtime import RealtimeConfig, enter_loop, request_realtime

PHASES = (0.0, 0.5)  # of two alternating loops


def run_idle_loops(
    rate_hz: float, seconds: float, realtime: RealtimeConfig
) -> list[dict[str, Any]]:
    """Run two idle loops for `seconds` [s]; return rate, overruns, work and CPU of each."""
    processes = [
        start_module(
            "teleop.cli.bench.bare_grid",
            *(str(rate_hz), str(seconds), str(phase), json.dumps(asdict(realtime))),
            is_supervised=True,
            stdout=subprocess.PIPE,
        )
        for phase in PHASES
    ]
    try:
        return [json.loads(process.communicate()[0]) for process in processes]
    finally:
        for process in processes:
            process.kill()
            process.wait()


def _run_idle_loop(
    rate_hz: float, seconds: float, phase: float, realtime: RealtimeConfig
) -> dict[str, Any]:
    granted = request_realtime(realtime)
    work = Durations()
    grid = Grid(rate_hz, StopCondition(seconds), phase)
    enter_loop(granted, realtime)
    used, begin = time.process_time(), time.monotonic()
    with pause_garbage_collection():
        for tick in grid:
            work.add(now_ns() - tick.stamp_ns)
    used, span = time.process_time() - used, time.monotonic() - begin
    return {
        "rate_hz": grid.stats.rate_hz,
        "overruns": grid.stats.overruns,
        "lateness_max_ms": grid.stats.lateness_max_ns * 1e-6,
        "work_us": asdict(work.compute_percentiles(1e-3)),
        "cpu": 100.0 * used / span,
    }


def main(words: list[str]) -> None:
    """Run one process: `RATE SECONDS PHASE SCHEDULING`."""
    limit_numeric_threads()
    die_with_launcher()
    rate_hz, seconds, phase = map(float, words[:3])
    realtime = RealtimeConfig(**json.loads(words[3]))
    print(json.dumps(_run_idle_loop(rate_hz, seconds, phase, realtime)), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
