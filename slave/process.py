"""Run the tendon side: the rig, the estimator of each tendon, and the last gate before the motors.

  teleop slave --config configs/demo.yaml
  teleop slave --config configs/demo.yaml --duration 30 --json slave.json
  teleop slave --config rig.yaml --model diagnosis/model.yaml     with what a diagnosis found

Without a master the motors hold, but for one thing: with `slave.initialise.at_start` the rig is
calibrated first, and every motor moves, whoever is there. When commands stop coming for longer than
`slave.freshness`, or anything else goes wrong, the motors hold too, until the operator lets go and
engages again; after an emergency stop (`teleop stop`) that has to be reset first.
"""

import argparse
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from estimator import extension, online
from estimator.effects.friction import VISCOUS_FRICTION
from slave import loop, models, outbox
from slave.calibration.initialise import initialise
from slave.config import SlaveConfig, doubts, has_model_file, hindrance_of, tendon_configs
from slave.control import JointEstimate
from slave.housekeeping import Housekeeping, calibrating
from slave.loop import Known, Memory
from slave.rig import Rig, RigFault, RigFinished, RigSample
from slave.rigs import RIG_COMPILE_S, compile_rig, open_rig
from slave.rigs.effect_words import late
from slave.rigs.simulated import SimulatedRigConfig
from slave.score import Score
from slave.tendon_config import TendonConfig
from teleop.clock import STALL_NS, Grid, Tick, now_ns, quiet_garbage
from teleop.compile_cache import announced
from teleop.config import add_arguments as add_config_arguments
from teleop.config import load
from teleop.coupling import LEDGER_PERIOD_NS, Bilateral, ledger_message
from teleop.errors import PeerError, TeleopError, UsageError
from teleop.launch.summary import force_line, loop_lines, trouble
from teleop.link import Counts, Link
from teleop.messages import MAX_JOINTS, PROFILE_POINTS, SlaveState
from teleop.meter import LoopMeter, in_words
from teleop.process import Stop, destination, seconds, supervised, write_summary
from teleop.realtime import enter_loop, go_realtime
from teleop.remote.door import Door, call_stop
from teleop.run_config import RunConfig
from teleop.session import Reason, Session, State
from teleop.tell import tell
from teleop.topics import (
    COMMAND,
    LEDGER,
    REPORT,
    STATE,
    TENDONS,
    Role,
)

COMPILE_S = 12.0  # [s] without a cache, on a machine that does nothing else
EXTENDED_COMPILE_S = 20.0  # [s] more


class Past(NamedTuple):
    """What a rig was used for before the loop."""

    start_ns: int  # from which its session time counts
    samples: tuple[RigSample, ...]  # all that it has given since, oldest first


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
        self,
        config: SlaveConfig,
        link: Link,
        rig: Rig,
        known: Known,
        grid: Grid,
        past: Past | None = None,
        bilateral: Bilateral = loop.DIRECT,
        door: Door | None = None,
    ) -> None:
        self.error: TeleopError | None = None
        self.ended = ""
        self._config, self._link, self._rig = config, link, rig
        self._known, self._bilateral = known, bilateral
        past = past or Past(now_ns(), ())
        self.memory = loop.start(known, rig.starts_at_zero, past.samples)
        self._meter = LoopMeter(Role.SLAVE, grid)
        self._housekeeping = Housekeeping(link, known)
        noise = max(model.tension_noise for model in known.models)
        self._score, self._verdicts = Score(noise), Counter[str]()
        self._freshness_ns = round(config.freshness * 1e9)
        self._start_ns = past.start_ns
        self._echo_ns = 0  # stamp of the newest command heard
        self._ledger_due_ns = 0
        self._door = door or Door(link)

    def tick(self, tick: Tick) -> None:
        """Read, step, write, publish."""
        time_s = (tick.stamp_ns - self._start_ns) * 1e-9
        samples, fault = self._read(time_s)
        latest = self._link.latest(COMMAND)
        command = latest.message
        now = now_ns()
        asked = self._door(now, self.memory.session.stops)
        if asked.words and self.memory.session.state is not State.STOPPED:  # the first caller's
            self._housekeeping.stop_words = asked.words

        def step(fault: Reason, late_s: float = 0.0) -> tuple[loop.Output, Memory]:
            return loop.step(
                self._known,
                self._config,
                self.memory,
                samples,
                command,
                latest.is_fresh(now_ns(), self._freshness_ns),
                fault,
                tick.dt + late_s,
                self._bilateral,
                asked.stop,
                asked.reset,
            )

        output, memory = step(fault)
        late_ns = now_ns() - now
        if late_ns > STALL_NS:
            output, memory = step(fault, late_ns * 1e-9)
        if output.motor and fault is Reason.NONE:
            try:
                self._rig.write(np.array(output.motor))
            except RigFault as error:
                output, memory = step(self._failed(error))
        self.memory = memory
        self._echo_ns = command.stamp_ns if command else 0
        self._publish(output)
        self._door.relay(Role.SLAVE, memory.session, asked.words)
        self._publish_ledger(tick.stamp_ns)
        self._verdicts[str(output.verdict.name)] += 1
        self._housekeeping(time_s, memory)
        self._report(tick.stamp_ns, latest.counts)
        self._meter.tick(memory.session, now_ns() - tick.stamp_ns, self._housekeeping.detail)

    def close(self) -> None:
        """Tell the others that the slave moves nothing any more; whatever happened before."""
        side = self.memory.session
        last = side if side.state in (State.OFF, State.FAULT, State.STOPPED) else Session()
        self._link.publish(STATE, self._state(last, (), 0.0))
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
        joints = loop.joint_estimates(self._known, memory)
        self._link.publish(STATE, self._state(memory.session, joints, memory.silence))
        for row in output.rows:
            self._link.publish(TENDONS, outbox.tendon_state(row, output.motor))
            self._score.add_row(row)

    def _publish_ledger(self, stamp_ns: int) -> None:
        if stamp_ns >= self._ledger_due_ns:
            self._ledger_due_ns = stamp_ns + LEDGER_PERIOD_NS
            joints = len(self._known.joints)
            self._link.publish(LEDGER, ledger_message(Role.SLAVE, self.memory.port, joints))

    def _state(
        self, side: Session, joints: Sequence[JointEstimate], sample_age: float
    ) -> SlaveState:
        signature = self._bilateral.signature
        return outbox.slave_state(
            side, self._echo_ns, joints, sample_age, self.memory.port, signature
        )

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
    models.add_argument(parser)
    parser.add_argument("--duration", type=seconds, metavar="S", help="end after S seconds")
    parser.add_argument(
        "--json", type=destination, metavar="FILE", help="write the summary to FILE"
    )


def main(args: argparse.Namespace) -> int:
    """Run the slave; returns the exit code."""
    shared = load(args.config, RunConfig, None, args.overrides)
    config = load(args.config, SlaveConfig, "slave", args.overrides)
    files = models.given(args.model)
    if files and config.initialise.at_start:
        raise UsageError("--model: slave.initialise.at_start finds the sheaths anew; give but one")
    prepare(config, extended=bool(files) or has_model_file(config))
    # before the link: its threads inherit the priority
    granted = go_realtime(shared.realtime)
    with ExitStack() as stack:
        # a slave that is refused as the second one must not have touched the rig
        link = stack.enter_context(Link(shared.link, shared.session, Role.SLAVE))
        rig = open_rig(config.rig)
        stack.callback(rig.close)
        require_carried(rig)
        for doubt in doubts(config, shared.coupling):
            print(doubt, flush=True)
        stop = Stop(args.duration)
        door = Door(link)
        link.subscribe_latest(COMMAND, round(config.freshness * 1e9))
        known, past = known_before(config, rig, link, door, stop, shared.rate_hz, files)
        grid = Grid(shared.rate_hz, stop, phase=0.5)
        slave = Slave(config, link, rig, known, grid, past, shared.bilateral, door)
        enter_loop(granted, shared.realtime)
        run(slave, grid, stop.request)
        summary = slave.summary()
    if isinstance(config.rig, SimulatedRigConfig):
        for line in late(config.rig.effects, summary["seconds"]):
            print(line, flush=True)
    summary |= {"stopped": stop.reason, "realtime": granted}
    write_summary(args.json, summary)
    if not supervised():
        print("\n".join([*loop_lines(summary), f"force     {force_line(summary['force_error'])}"]))
    if slave.error:
        raise slave.error
    if not supervised() and (ended := trouble({"slave": summary})):
        raise TeleopError(ended)
    return 0


def require_carried(rig: Rig) -> None:
    """Refuse a rig that the messages have no room for."""
    if not 1 <= len(rig.joints) <= MAX_JOINTS or any(len(j) not in (1, 2) for j in rig.joints):
        raise UsageError(
            f"slave.rig: tendons {rig.joints}, must be 1 to {MAX_JOINTS} joints of 1 or 2 tendons"
        )


def known_before(
    config: SlaveConfig,
    rig: Rig,
    link: Link,
    door: Door,
    stop: Stop,
    rate_hz: float,
    files: models.Given,
) -> tuple[Known, Past]:
    """Return what is known of a rig when the loop begins, and what it has measured before.

    Model `files` stand in for what the config says of the sheaths. If the config asks for it, the
    rig is calibrated first, in its quick form; `TeleopError` if that has to be given up. An
    emergency stop at the `door` ends it where the motors are.
    """
    past = Past(now_ns(), ())
    if not config.initialise.at_start:
        tendons = tendon_configs(config, rig.tendons, rig.joints, files)
        said = introduced(tendons)
        if files and (config.tendons or config.calibration):
            said += models.strange(tendon_configs(config, rig.tendons, rig.joints), tendons)
        for line in said:
            print(line, flush=True)
        barred = hindrance_of(config, rig, modelled=bool(files))
        return loop.know(rig.joints, [tendon.model() for tendon in tendons], barred), past

    def stopped() -> str:
        asked = door(now_ns())
        master = link.latest(COMMAND).message
        if asked.stop:
            call_stop(link, Role.SLAVE, asked.words or asked.stop.text)
            raise TeleopError(f"calibration given up: {in_words(asked.stop, asked.words)}")
        if master is not None and State(master.state) is State.STOPPED:
            raise TeleopError(f"calibration given up: {Reason.PEER_STOPPED.text}")
        return stop.reason if stop() else ""

    tell(link, Role.SLAVE, Session(), f"off: calibrating {rig.name}; keep its joints free")
    done = initialise(
        rig,
        config,
        Grid(rate_hz, lambda: False, phase=0.5),
        past.start_ns,
        stopped=stopped,
        progress=calibrating(rig),
    )
    tell(link, Role.SLAVE, Session(), f"off: {rig.name} is calibrated")
    found = [tendon.model() for tendon in done.calibration.tendons]
    return loop.know(rig.joints, found), past._replace(samples=done.samples)


def introduced(tendons: Sequence[TendonConfig]) -> list[str]:
    """Return what the models of diagnoses do in the loop, and what is doubtful about them."""
    said: dict[str, None] = {}
    for tendon in tendons:
        for sentence in models.sentences(tendon):
            said[f"{tendon.model_file}: {sentence}"] = None
        if tendon.model_file is not None and tendon.tension_noise == 0.0:
            line = f"WARNING: {tendon.model_file}: no tension_noise is known beside it: noise is"
            said[f"{line} taken for tension, and a stuck load cell may not be noticed"] = None
    return list(said)


def prepare(config: SlaveConfig, extended: bool) -> None:
    """Compile and import what the session calls, before it runs at real-time priority."""
    about = COMPILE_S + EXTENDED_COMPILE_S * extended + RIG_COMPILE_S[type(config.rig)]
    with announced("the estimator", about):
        warm_up(extended)
        compile_rig(config.rig)
    if config.initialise.at_start:
        import_module("scipy.optimize")  # which the analysis of a calibration uses


def warm_up(extended: bool = False) -> None:
    """Compile what the loop calls, before it has to be on time; `extended` models take longer."""
    viscous = extension.extended((1.0, 1e-4, 0.0), [(VISCOUS_FRICTION, (1.0,))], 1.0, 1.0)
    for extra in (None, viscous.extension) if extended else (None,):
        prepared = online.prepare(online.TendonModel(viscous.sheath, extension=extra))
        _, state = online.step(prepared, online.initial(prepared), 1.0, 0.0, 0.0)
        online.profile_at(prepared, state, np.zeros(PROFILE_POINTS))
