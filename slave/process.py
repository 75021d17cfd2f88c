"""Run the tendon side: the rig, the estimator of each tendon, and the last gate before the motors.

  teleop slave --config configs/demo.yaml
  teleop slave --config configs/demo.yaml --duration 30 --json slave.json

Without a master the motors hold. When commands stop coming for longer than `slave.freshness`, or
anything else goes wrong, the motors hold too, until the operator lets go and engages again.
"""

import argparse
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any, NamedTuple

import numpy as np

from estimator import online
from slave import loop, outbox
from slave.config import SlaveConfig, tendon_configs
from slave.loop import Memory
from slave.rig import Rig, RigFault, RigFinished, RigSample
from slave.rigs import open_rig
from slave.score import Score
from teleop.clock import Grid, now_ns, quiet_garbage
from teleop.config import add_arguments as add_config_arguments
from teleop.config import load
from teleop.errors import TeleopError
from teleop.link import Link
from teleop.messages import PROFILE_POINTS, Event, text_bytes
from teleop.meter import LoopMeter
from teleop.process import Stop, go_realtime, write_summary
from teleop.run_config import RunConfig
from teleop.session import Reason, Session
from teleop.topics import (
    COMMAND,
    EVENT,
    PROFILE,
    REPORT,
    SHEATH,
    STATE,
    TENDONS,
    Role,
)

PROFILE_PERIOD_S = 0.02  # one tendon's T(x) each; the viewer shows no more
SHEATH_PERIOD_S = 1.0  # for listeners that come late


class Tendon(NamedTuple):
    """What the estimator knows of one tendon, readable and prepared."""

    model: online.TendonModel
    prepared: online.Prepared


class Housekeeping:
    """What the slave tells listeners now and then: events, profiles, sheath shapes."""

    def __init__(self, link: Link, tendons: Sequence[Tendon]) -> None:
        self._link, self._tendons = link, tendons
        self._points = [np.linspace(0.0, t.model.sheath.length, PROFILE_POINTS) for t in tendons]
        self._said = Session()
        self._next_profile_s = self._next_sheath_s = 0.0
        self._tendon = 0

    def __call__(self, time_s: float, memory: Memory) -> None:
        """Publish what is due at session time `time_s` [s]."""
        if memory.session != self._said:
            self._said = memory.session
            self._link.publish(EVENT, event(memory.session))
        if time_s >= self._next_profile_s and memory.newest is not None:
            self._next_profile_s = time_s + PROFILE_PERIOD_S
            self._publish_profile(memory)
        if time_s >= self._next_sheath_s:
            self._next_sheath_s = time_s + SHEATH_PERIOD_S
            for k, tendon in enumerate(self._tendons):
                self._link.publish(SHEATH, outbox.sheath(k, tendon.model.sheath))

    def _publish_profile(self, memory: Memory) -> None:
        assert memory.newest is not None  # noqa: S101 - asked by the caller
        k = self._tendon
        self._tendon = (k + 1) % len(self._tendons)
        x = self._points[k]
        tension = online.profile_at(self._tendons[k].prepared, memory.estimators[k], x)
        front = memory.newest.estimates[k].front
        self._link.publish(PROFILE, outbox.tension_profile(k, x[-1], front, tension.tolist()))


def event(side: Session) -> Event:
    """Return the event that tells of a new session state."""
    text = f"{side.state.name.lower()}: {side.reason.text}"
    return Event(role=Role.SLAVE, state=side.state, reason=side.reason, text=text_bytes(text))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop slave`."""
    add_config_arguments(parser)
    parser.add_argument("--duration", type=float, metavar="S", help="end after S seconds")
    parser.add_argument("--json", metavar="FILE", help="write the summary to FILE")


def main(args: argparse.Namespace) -> int:
    """Run the slave; returns the exit code."""
    shared = load(args.config, RunConfig, None, args.overrides)
    config = load(args.config, SlaveConfig, "slave", args.overrides)
    with ExitStack() as stack:
        rig = open_rig(config.rig)
        stack.callback(rig.close)
        models = [tendon.model() for tendon in tendon_configs(config, rig.tendons)]
        tendons = [Tendon(model, online.prepare(model)) for model in models]
        warm_up(tendons[0].prepared)
        granted = go_realtime()  # before the link: its threads are as urgent, and inherit it
        stop = Stop(args.duration)
        link = stack.enter_context(Link(shared.link, shared.session, Role.SLAVE))
        summary = run(link, rig, tendons, config, shared.rate_hz, stop)
    summary["realtime"] = granted
    write_summary(args.json, summary)
    if summary["fault"]:
        raise TeleopError(f"slave: {summary['fault']}")
    return 0


def warm_up(prepared: online.Prepared) -> None:
    """Compile what the loop calls, before it has to be on time."""
    _, state = online.step(prepared, online.initial(prepared), 1.0, 0.0, 0.0)
    online.profile_at(prepared, state, np.zeros(PROFILE_POINTS))


def run(
    link: Link,
    rig: Rig,
    tendons: Sequence[Tendon],
    config: SlaveConfig,
    rate_hz: float,
    stop: Stop,
) -> dict[str, Any]:
    """Run the loop until told to stop, and return its summary."""
    housekeeping = Housekeeping(link, tendons)
    prepared = [tendon.prepared for tendon in tendons]
    grid = Grid(rate_hz, stop, phase=0.5)
    meter = LoopMeter(Role.SLAVE, grid)
    score, verdicts = Score(), Counter[str]()
    freshness_ns = round(config.freshness * 1e9)
    link.subscribe_latest(COMMAND)
    memory = loop.start(prepared)
    fault, cause = Reason.NONE, ""
    begin_ns = now_ns()
    with quiet_garbage():
        for tick in grid:
            time_s = (tick.stamp_ns - begin_ns) * 1e-9
            samples: Sequence[RigSample] = ()
            try:
                samples = rig.read(time_s)
            except RigFinished:
                fault, cause = Reason.RIG_FINISHED, ""
                stop.request(fault.text)
            except RigFault as error:
                fault, cause = Reason.RIG_FAULT, str(error)
                stop.request(fault.text)
            latest = link.latest(COMMAND)
            fresh = latest.is_fresh(now_ns(), freshness_ns)
            output, memory = loop.step(
                prepared, config, memory, samples, latest.message, fresh, fault, tick.dt
            )
            if fault is Reason.NONE and output.motor:
                rig.write(np.array(output.motor))
            echo = latest.message.stamp_ns if latest.message else 0
            link.publish(STATE, outbox.slave_state(memory.session, echo, memory.newest))
            for row in output.rows:
                link.publish(TENDONS, outbox.tendon_state(row, output.motor))
                score.add_row(row)
            verdicts[output.verdict.name or "PASSED"] += 1
            housekeeping(time_s, memory)
            report = meter.report(tick.stamp_ns, memory.session, latest.counts)
            if report is not None:
                link.publish(REPORT, report)
                link.check_peers()
            meter.work.add(now_ns() - tick.stamp_ns)
    summary = meter.summary(memory.session, link.counts(), verdicts)
    return summary | {"force_error": score.summary(), "stopped": stop.reason, "fault": cause}
