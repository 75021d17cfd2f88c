"""One tick of the slave, as a pure function.

Samples and a command go in; motor positions, estimates and a session state come out. No clock, no
link, no rig: the process around it has those, and tests have none.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator import online
from slave import control, gate, port, standing, watch
from slave.calibration import monitor
from slave.calibration.monitor import Advice
from slave.config import SlaveConfig
from slave.control import Control, JointEstimate, TendonSeen
from slave.rig import RigSample
from slave.standing import Standing
from slave.watch import Finding, Motors, Watch
from teleop import session
from teleop.coupling import Bilateral, Side
from teleop.messages import Command
from teleop.session import Reason, Session

EstimatorState = NDArray[np.float64]

DIRECT = Bilateral()

OVERLOAD = 1.2  # times the gate's tension limit; noise and stretch reach over the limit itself
OVERLOAD_S = 0.020  # [s] a collision's peak passes sooner
_ABSURD = 1e3  # [m], [m/s] no tip goes there or as fast; NaN is not below it either

NO_SAMPLE = "the rig has given no sample yet"
NO_POSITION = "no encoder reading tells where the motors stand, and the rig does not start at zero"


class Known(NamedTuple):
    """What is known of the rig before the first tick."""

    joints: tuple[tuple[int, ...], ...]  # `Rig.joints`
    models: tuple[online.TendonModel, ...]  # of each tendon
    prepared: tuple[online.Prepared, ...]  # the same, for the estimator
    watched: tuple[monitor.Watched, ...]  # the same, for the monitor of their calibration
    barred: str = ""  # why it must not be engaged, in words: no calibration that fits it


class Row(NamedTuple):
    """One sample of the rig and what is estimated from it, for each tendon."""

    sample: RigSample
    estimates: tuple[online.TendonEstimate, ...]
    tendons: tuple[TendonSeen, ...]  # as they were read
    corrected: tuple[TendonSeen, ...]  # without the effects that a model knows of their sensors


class Memory(NamedTuple):
    """All that the slave remembers from one tick to the next."""

    session: Session
    estimators: tuple[EstimatorState, ...]
    standing: Standing
    watch: Watch
    motor: tuple[float, ...] = ()  # [m] what the gate last let through; empty = never engaged yet
    newest: Row | None = None
    elapsed: float = 0.0  # [s] between the newest sample and the one before
    offsets: tuple[float, ...] = ()  # [m] of each joint's tendons, see `control.joint_estimate`
    motors: Motors = Motors()  # whether they go where they are sent
    found: Finding | None = None  # what the watch found wrong last, and where
    monitors: tuple[monitor.Watch, ...] = ()  # of each tendon's calibration
    advice: Advice = Advice.NONE
    port: Side = Side()  # of the coupling
    following: Control = Control()
    silence: float = 0.0  # [s] since the last sample that was new and could be used
    overload: float = 0.0  # [s] for which a tension has been far over its limit, engaged
    hindrance: str = NO_SAMPLE  # why the rig is not usable, in words; empty if it is


class Output(NamedTuple):
    """What a tick asks of the world."""

    motor: tuple[float, ...]  # [m] to be written to the rig; empty = nothing yet
    verdict: gate.Verdict
    rows: tuple[Row, ...]  # the samples that were new, oldest first


def know(
    joints: Sequence[Sequence[int]], models: Sequence[online.TendonModel], barred: str = ""
) -> Known:
    """Return what is known of a rig whose tendons have these models."""
    return Known(
        tuple(tuple(joint) for joint in joints),
        tuple(models),
        tuple(online.prepare(model) for model in models),
        tuple(monitor.prepare(model) for model in models),
        barred,
    )


def start(known: Known, starts_at_zero: bool, samples: Sequence[RigSample] = ()) -> Memory:
    """Return the memory of a slave that has just started; see `Rig.starts_at_zero`.

    `samples` of the rig, oldest first, are all that it measured before: the tensions along the
    tendons are then known from the start.
    """
    states = tuple(online.initial(p) for p in known.prepared)
    memory = Memory(
        Session(),
        states,
        standing.start(len(known.prepared), starts_at_zero),
        watch.start(known.joints, known.prepared),
        monitors=(monitor.Watch(),) * len(known.models),
    )
    for sample in samples:
        memory, _ = take(known, memory, sample)
    return memory._replace(standing=standing.step(memory.standing, samples, 0.0))


def step(
    known: Known,
    config: SlaveConfig,
    memory: Memory,
    samples: Sequence[RigSample],
    command: Command | None,
    fresh: bool,
    fault: Reason,
    dt: float,
    bilateral: Bilateral = DIRECT,
    stop: Reason = Reason.NONE,
    reset: bool = False,
) -> tuple[Output, Memory]:
    """Advance the slave by one tick.

    Until it engages for the first time nothing is asked of the motors. From then on they are asked
    to be somewhere at every tick: where the gate let them go last, unless they are commanded on.

    Parameters
    ----------
    known : Known
        The rig's joints and tendons.
    config : SlaveConfig
        Limits of the gate, of the watch and of silence; the controller's gains.
    samples : sequence of RigSample
        All samples since the last tick, oldest first; the estimator takes each once.
    command : Command or None
        The newest command, if one ever came.
    fresh : bool
        Whether it is young enough to be obeyed.
    fault : Reason
        What is wrong on this side now, as far as the caller knows; `Reason.NONE` if nothing.
    dt : float
        Time since the last tick [s].
    bilateral : Bilateral
        What the session's config says of confidence and coupling.
    stop, reset : Reason, bool
        Why another process wants everything to stop, if one does; whether one takes that back.
    """
    after, rows, found = memory, [], None
    for sample in samples:
        after, row = take(known, after, sample)
        rows.append(row)
        seen = row.tendons
        finding, watched = watch.step(config.watch, known.joints, after.watch, seen, after.elapsed)
        after, found = after._replace(watch=watched), finding or found
        after = monitored(known, config, after, row)
    if config.rig_obeys:
        astray, motors = watch.watch_motors(
            config.watch, memory.motors, [row.tendons for row in rows], memory.motor, dt
        )
        after, found = after._replace(motors=motors), found or astray
    newest = after.newest
    overloaded = memory.session.may_move and overload(config.gate, newest)
    after = after._replace(
        standing=standing.step(memory.standing, samples, dt),
        silence=0.0
        if any(map(usable, rows)) and not after.motors.repeated
        else memory.silence + dt,
        overload=memory.overload + dt if overloaded else 0.0,
        found=found if rows else memory.found,
    )
    motor = memory.motor or standing.known(after.standing, config.silence_max)
    hindrance = NO_SAMPLE if newest is None else known.barred or ("" if motor else NO_POSITION)
    master = session.State(command.state) if command is not None else session.State.OFF
    asks = fresh and master is session.State.ENGAGED
    joints = len(known.joints) if command is not None and asks else 0
    asked = command.position[:joints] if command is not None else ()
    speed = command.velocity[:joints] if command is not None else ()

    side = session.step(
        memory.session,
        session.Inputs(
            usable=not hindrance,
            peer_fresh=fresh,
            peer_state=master,
            engage=session.switch_of(master),
            fault=fault if fault is not Reason.NONE else own_fault(config, after, asked + speed),
            hindrance=Reason.COUPLING_DIFFERS
            if command is not None and bilateral.differs(command.coupling)
            else Reason.NONE,
            clutch=master is session.State.CLUTCHED,
            stop=stop,
            reset=reset,
            peer=command.sender if command is not None else 0,
        ),
        dt,
    )
    engaged = side.may_move and asks
    told = joint_estimates(known, after) if engaged else ()
    asked, speed, ports = port.step(
        bilateral, memory.port, command, asked, speed, told, engaged, dt
    )
    after = after._replace(session=side, hindrance=hindrance, port=ports)
    if newest is None or not (memory.motor or engaged):
        return Output((), gate.Verdict.HELD, tuple(rows)), after
    wanted, following = control.step(
        config.control,
        known.joints,
        memory.following,
        asked,
        motor,
        newest.tendons,
        engaged,
        dt,
        speed,
    )
    reach = (
        gate.reaches(
            config.gate, known.joints, [joint.position for joint in told], [j.force for j in told]
        )
        if told
        else ()
    )
    motor, verdict = gate.step(
        config.gate,
        motor,
        wanted,
        tension(newest),
        after.silence,
        engaged,
        dt,
        reach,
        side.may_yield,
    )
    return Output(motor, verdict, tuple(rows)), after._replace(motor=motor, following=following)


def own_fault(config: SlaveConfig, memory: Memory, asked: Sequence[float]) -> Reason:
    """Return what the slave itself finds wrong; `asked` of it is empty unless it shall move."""
    if memory.newest is not None and memory.silence > config.silence_max:
        return Reason.SAMPLES_FROZEN if memory.motors.repeated else Reason.SAMPLES_STALE
    if memory.overload > OVERLOAD_S:
        return Reason.OVER_LIMIT
    if memory.found is not None:
        return memory.found.reason
    if memory.advice is Advice.DEMANDED:
        return Reason.CALIBRATION_DUE
    sound = all(abs(value) < _ABSURD for value in asked)
    return Reason.NONE if sound else Reason.NOT_FINITE


def overload(limits: gate.GateConfig, newest: Row | None) -> bool:
    """Return whether a tendon pulls so hard that refusing to pull further has not helped."""
    if newest is None:
        return False
    both = (*newest.tendons, *newest.corrected)
    return any(tendon.tension > OVERLOAD * limits.tension_max for tendon in both)


def refused(estimates: online.TendonEstimate) -> bool:
    """Return whether the estimator refused the sample behind its estimate."""
    return bool(estimates.status & online.Status.INVALID_INPUT)


def usable(row: Row) -> bool:
    """Return whether every tendon's sample could be used by its estimator."""
    return not any(map(refused, row.estimates))


def tension(row: Row) -> list[float]:
    """Return the tensions [N] at the housing that limits go by; NaN where a sample was refused.

    The larger one of what was read and what a model makes of it.
    """
    return [
        math.nan if refused(e) else max(tendon.tension, right.tension)
        for e, tendon, right in zip(row.estimates, row.tendons, row.corrected, strict=True)
    ]


def take(known: Known, memory: Memory, sample: RigSample) -> tuple[Memory, Row]:
    """Step each tendon's estimator with one sample."""
    before = memory.newest
    elapsed = sample.time_s - before.sample.time_s if before else 0.0
    tension = sample.proximal_tension.tolist()
    displacement = sample.proximal_displacement
    travel = [math.nan] * len(tension) if displacement is None else displacement.tolist()
    estimates, states, right = [], [], []
    for model, state, force, position in zip(
        known.prepared, memory.estimators, tension, travel, strict=True
    ):
        right.append(online.right(model, state, force, position))
        result, advanced = online.step(model, state, force, position, elapsed)
        estimates.append(result)
        states.append(advanced)
    seen = control.seen(sample, estimates)
    corrected = tuple(
        tendon._replace(tension=T, displacement=q)
        for tendon, (T, q) in zip(seen, right, strict=True)
    )
    row = Row(sample, tuple(estimates), seen, corrected)
    after = memory._replace(estimators=tuple(states), newest=row, elapsed=elapsed)
    if not after.offsets and usable(row):
        offsets = tuple(control.offset([row.tendons[i] for i in j]) for j in known.joints)
        after = after._replace(offsets=offsets if all(map(math.isfinite, offsets)) else ())
    return after, row


def monitored(known: Known, config: SlaveConfig, memory: Memory, row: Row) -> Memory:
    """Take note of whether the sheaths still have the shape they were calibrated in."""
    against = [0.0] * len(row.tendons)
    for joint in known.joints:
        for one, other in zip(joint, joint[::-1], strict=True):
            if one != other:
                against[one] = row.estimates[other].distal_tension
    monitors = tuple(
        monitor.step(
            config.monitor,
            watched,
            before,
            tendon.estimate,
            tendon.tension,
            tendon.displacement,
            other,
            memory.elapsed,
        )
        for watched, before, tendon, other in zip(
            known.watched, memory.monitors, row.corrected, against, strict=True
        )
    )
    advice = monitor.advice(config.monitor, monitors)
    return memory._replace(monitors=monitors, advice=advice)


def joint_estimates(known: Known, memory: Memory) -> tuple[JointEstimate, ...]:
    """Return what is known of the joints by the newest sample; nothing before the first."""
    if memory.newest is None:
        return ()
    told = memory.newest.tendons
    offsets = memory.offsets or (0.0,) * len(known.joints)
    return tuple(
        control.joint_estimate([told[i] for i in joint], offset)
        for joint, offset in zip(known.joints, offsets, strict=True)
    )
