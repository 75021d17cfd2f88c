"""Measure how transparent and how stable each coupling is, over each delay.

  python -m studies.transparency
  python -m studies.transparency --couplings passivity --round-trips 0 100 --quick
  python -m studies.transparency --jitter 50 --loss 0.1

The live code of master and slave, with a simulated hand, network and rig: rendered against true
stiffness, Z-width, hybrid parameters over frequency, and Llewellyn's margin where it applies; how
each is measured is in studies/results/coupling.md. Takes 6 minutes on two cores, a minute with
--quick and two delays.
"""

from dataclasses import replace
from functools import partial
from typing import Any

from studies.testbed.command import parse_options
from studies.testbed.parallel import map_in_parallel
from studies.transparency import report, study
from studies.transparency.study import COUPLINGS, Case, Study, Task
from teleop.runtime.machine import count_processors
from teleop.runtime.status_line import Progress


def main() -> None:
    """Run the study."""
    default = Study()
    args = parse_options(
        __doc__,
        couplings=(COUPLINGS, "to measure"),
        round_trips=(tuple(1e3 * s for s in default.round_trips), "delays, at most 400 [ms]"),
        jitter=(0.0, "by which the round trip varies to both sides [ms]"),
        loss=(0.0, "share of messages lost each way"),
        encoder=(1e6 * default.device.resolution, "resolution of the device [um]"),
        force_scale=(default.force_scale, "force on the hand per force at the tip"),
        position_scale=(default.position_scale, "tip travel per hand travel"),
        quick=(False, "fewer stiffnesses, hands and lines"),
        jobs=(count_processors(), "processes"),
    )
    commanded = Study(
        couplings=tuple(args.couplings),
        round_trips=tuple(1e-3 * ms for ms in args.round_trips),
        jitter=1e-3 * args.jitter,
        loss=args.loss,
        device=replace(default.device, resolution=1e-6 * args.encoder),
        force_scale=args.force_scale,
        position_scale=args.position_scale,
    )
    if args.quick:
        commanded = study.shorten_study(commanded)
    print(report.format_tables(commanded, run_study(commanded, args.jobs)))


def run_study(commanded: Study, workers: int) -> list[Case]:
    """Return what was measured, in so many processes."""
    tasks, done = study.list_tasks(commanded), dict[Task, Any]()
    with Progress() as progress:
        results = map_in_parallel(partial(study.measure_task, commanded), tasks, workers)
        for task in tasks:
            progress(f"{task.kind}, {task.coupling}", len(done) / len(tasks))
            done[task] = next(results)
    return study.gather_cases(commanded, done)


if __name__ == "__main__":
    main()
