"""Run the tendon side: the rig, the estimator of each tendon, and the last gate before the motors.

  teleop slave --config configs/demo.yaml
  teleop slave --config configs/demo.yaml --duration 30 --json slave.json

Without a master the motors hold. When commands stop coming for longer than `slave.freshness`, or
anything else goes wrong, the motors hold too, until the operator lets go and engages again.
"""

import argparse
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any, NamedTuple

import numpy as np

from estimator import online
from estimator.sheath import Sheath
from slave import loop, outbox
from slave.config import SlaveConfig, doubts, tendon_configs
from slave.loop import Memory
from slave.rig import Rig, RigFault, RigFinished, RigSample
from slave.rigs import open_rig
from slave.score import Score
from teleop.clock import Grid, Tick, now_ns, quiet_garbage
from teleop.config import add_arguments as add_config_arguments
from teleop.config import load
from teleop.errors import PeerError, TeleopError, UsageError
from teleop.launch.summary import force_line, loop_lines
from teleop.link import Counts, Link
from teleop.messages import MAX_JOINTS, PROFILE_POINTS
from teleop.meter import LoopMeter
from teleop.process import Stop, destination, go_realtime, seconds, supervised, write_summary
from teleop.run_config import RunConfig
from teleop.session import Reason, Session, State
from teleop.tell import tell
from teleop.topics import (
    COMMAND,
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
        self._said: tuple[Session, str] | None = None
        self._next_profile_s = self._next_sheath_s = 0.0
        self._tendon = 0

    def __call__(self, time_s: float, memory: Memory) -> None:
        """Publish what is due at session time `time_s` [s]."""
        now = memory.session, memory.hindrance
        if now != self._said:
            self._said = now
            tell(self._link, Role.SLAVE, memory.session, in_words(*now))
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


def in_words(side: Session, hindrance: str) -> str:
    """Return what is told of a new session state, and why the rig is not usable."""
    text = f"{side.state.name.lower()}: {side.reason.text}"
    if side.reason is Reason.NOT_USABLE:
        text = f"{text}: {hindrance}"
    return text


class Slave:
    """The world around `loop.step`: one rig, one link, and the counts.

    Attributes
    ----------
    error : TeleopError or None
        What ended the session, if it was not asked to end.
    ended : str
        Why it is over, from this side; empty while it is not.
    """

    def __init__(
        self, config: SlaveConfig, link: Link, rig: Rig, tendons: Sequence[Tendon], grid: Grid
    ) -> None:
        self.error: TeleopError | None = None
        self.ended = ""
        self._config, self._link, self._rig = config, link, rig
        self._prepared = [tendon.prepared for tendon in tendons]
        self.memory = loop.start(self._prepared, rig.starts_at_zero)
        self._meter = LoopMeter(Role.SLAVE, grid)
        self._housekeeping = Housekeeping(link, tendons)
        self._score, self._verdicts = Score(), Counter[str]()
        self._freshness_ns = round(config.freshness * 1e9)
        self._start_ns = now_ns()
        self._echo_ns = 0  # stamp of the newest command heard
        link.subscribe_latest(COMMAND)

    def tick(self, tick: Tick) -> None:
        """Read, step, write, publish."""
        time_s = (tick.stamp_ns - self._start_ns) * 1e-9
        samples, fault = self._read(time_s)
        latest = self._link.latest(COMMAND)
        command = latest.message
        fresh = latest.is_fresh(now_ns(), self._freshness_ns)

        def step(fault: Reason) -> tuple[loop.Output, Memory]:
            return loop.step(
                self._prepared, self._config, self.memory, samples, command, fresh, fault, tick.dt
            )

        output, memory = step(fault)
        if output.motor and fault is Reason.NONE:
            try:
                self._rig.write(np.array(output.motor))
            except RigFault as error:
                output, memory = step(self._failed(error))
        self.memory = memory
        self._echo_ns = command.stamp_ns if command else 0
        self._publish(output)
        self._verdicts[str(output.verdict.name)] += 1
        self._housekeeping(time_s, memory)
        self._report(tick.stamp_ns, latest.counts)
        self._meter.tick(memory.session, now_ns() - tick.stamp_ns)

    def close(self) -> None:
        """Tell the others that the slave moves nothing any more; whatever happened before."""
        side = self.memory.session
        last = side if side.state in (State.OFF, State.FAULT) else Session()
        self._link.publish(STATE, outbox.slave_state(last, self._echo_ns, None, 0.0))
        tell(self._link, Role.SLAVE, last, f"off: {self.ended or 'ended'}")

    def summary(self) -> dict[str, Any]:
        """Return the run in numbers."""
        numbers = self._meter.summary(self.memory.session, self._link.counts(), self._verdicts)
        return numbers | {"force_error": self._score.summary(), "rig": self._rig.summary()}

    def _read(self, time_s: float) -> tuple[Sequence[RigSample], Reason]:
        try:
            return self._rig.read(time_s), Reason.NONE
        except RigFinished:
            self.ended = Reason.RIG_FINISHED.text
            return (), Reason.RIG_FINISHED
        except RigFault as error:
            return (), self._failed(error)

    def _failed(self, error: RigFault) -> Reason:
        self._end(TeleopError(f"rig: {error}"))
        return Reason.RIG_FAULT

    def _end(self, error: TeleopError) -> None:
        self.error = self.error or error
        self.ended = str(self.error)

    def _publish(self, output: loop.Output) -> None:
        memory = self.memory
        state = outbox.slave_state(memory.session, self._echo_ns, memory.newest, memory.silence)
        self._link.publish(STATE, state)
        for row in output.rows:
            self._link.publish(TENDONS, outbox.tendon_state(row, output.motor))
            self._score.add_row(row)

    def _report(self, stamp_ns: int, counts: Counts) -> None:
        report = self._meter.report(stamp_ns, self.memory.session, counts)
        if report is None:
            return
        self._link.publish(REPORT, report)
        try:
            self._link.check_peers()
        except PeerError as error:
            self._end(error)


def run(slave: Slave, grid: Grid, stop_for: Callable[[str], None]) -> None:
    """Tick until told to stop; the others are told, however this ends."""
    try:
        with quiet_garbage():
            for tick in grid:
                slave.tick(tick)
                if slave.ended:
                    stop_for(slave.ended)
    finally:
        slave.close()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop slave`."""
    add_config_arguments(parser)
    parser.add_argument("--duration", type=seconds, metavar="S", help="end after S seconds")
    parser.add_argument(
        "--json", type=destination, metavar="FILE", help="write the summary to FILE"
    )


def main(args: argparse.Namespace) -> int:
    """Run the slave; returns the exit code."""
    shared = load(args.config, RunConfig, None, args.overrides)
    config = load(args.config, SlaveConfig, "slave", args.overrides)
    warm_up()
    granted = go_realtime()  # before the link: its threads are as urgent, and inherit it
    with ExitStack() as stack:
        # a slave that is refused as the second one must not have touched the rig
        link = stack.enter_context(Link(shared.link, shared.session, Role.SLAVE))
        rig = open_rig(config.rig)
        stack.callback(rig.close)
        if not 1 <= rig.tendons <= MAX_JOINTS:
            raise UsageError(f"slave.rig: {rig.tendons} tendons, must be 1 to {MAX_JOINTS}")
        for doubt in doubts(config):
            print(doubt, flush=True)
        models = [tendon.model() for tendon in tendon_configs(config, rig.tendons)]
        tendons = [Tendon(model, online.prepare(model)) for model in models]
        stop = Stop(args.duration)
        grid = Grid(shared.rate_hz, stop, phase=0.5)
        slave = Slave(config, link, rig, tendons, grid)
        run(slave, grid, stop.request)
        summary = slave.summary()
    summary |= {"stopped": stop.reason, "realtime": granted}
    write_summary(args.json, summary)
    if not supervised():
        print("\n".join([*loop_lines(summary), f"force     {force_line(summary['force_error'])}"]))
    if slave.error:
        raise slave.error
    return 0


def warm_up() -> None:
    """Compile what the loop calls, before it has to be on time."""
    prepared = online.prepare(online.TendonModel(Sheath.uniform(1.0, 1.0, 1e4)))
    _, state = online.step(prepared, online.initial(prepared), 1.0, 0.0, 0.0)
    online.profile_at(prepared, state, np.zeros(PROFILE_POINTS))
