"""The baseline of a loop: idle processes that tick at its rate and priority."""

import json
import os
import subprocess
import sys
import time
from typing import Any

from teleop.runtime.clock import Grid, now_ns, quiet_garbage
from teleop.runtime.process import (
    SUPERVISED,
    Stop,
    die_with_launcher,
    limit_numeric_threads,
    module_command,
)
from teleop.runtime.realtime import RealtimeConfig, enter_loop, go_realtime
from teleop.runtime.timing import Durations

PHASES = (0.0, 0.5)  # of two alternating loops


def run_bare(rate_hz: float, seconds: float, realtime: RealtimeConfig) -> list[dict[str, Any]]:
    """Run two idle loops for `seconds` [s]; return rate, overruns, work and CPU of each."""
    processes = [
        subprocess.Popen(
            [
                *module_command("teleop.cli.bench.bare_grid"),
                *(str(rate_hz), str(seconds)),
                *(str(phase), str(realtime.priority), json.dumps(realtime.cores)),
            ],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            env=os.environ | {SUPERVISED: str(os.getpid())},
        )
        for phase in PHASES
    ]
    try:
        return [json.loads(process.communicate()[0]) for process in processes]
    finally:
        for process in processes:
            process.kill()
            process.wait()


def _tick(rate_hz: float, seconds: float, phase: float, realtime: RealtimeConfig) -> dict[str, Any]:
    granted = go_realtime(realtime)
    work = Durations()
    grid = Grid(rate_hz, Stop(seconds), phase)
    enter_loop(granted, realtime)
    used, begin = time.process_time(), time.monotonic()
    with quiet_garbage():
        for tick in grid:
            work.add(now_ns() - tick.stamp_ns)
    used, span = time.process_time() - used, time.monotonic() - begin
    return {
        "rate_hz": grid.stats.rate_hz,
        "overruns": grid.stats.overruns,
        "lateness_max_ms": grid.stats.lateness_max_ns * 1e-6,
        "work_us": work.percentiles(1e-3),
        "cpu": 100.0 * used / span,
    }


def main(words: list[str]) -> None:
    """Run one process: `RATE SECONDS PHASE PRIORITY CORES`."""
    limit_numeric_threads()
    die_with_launcher()
    rate_hz, seconds, phase = map(float, words[:3])
    cores = json.loads(words[4])
    realtime = RealtimeConfig(int(words[3]), cores if cores == "auto" else tuple(cores))
    print(json.dumps(_tick(rate_hz, seconds, phase, realtime)), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
