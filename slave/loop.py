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
from slave import control, gate, standing
from slave.config import SlaveConfig
from slave.control import Control
from slave.rig import RigSample
from slave.standing import Standing
from teleop import session
from teleop.messages import Command
from teleop.session import Reason, Session

EstimatorState = NDArray[np.float64]

OVERLOAD = 1.2  # times the gate's tension limit; noise and stretch reach over the limit itself
OVERLOAD_S = 0.020  # [s] a collision's peak passes sooner

NO_SAMPLE = "the rig has given no sample yet"
NO_POSITION = "no encoder reading tells where the motors stand, and the rig does not start at zero"


class Row(NamedTuple):
    """One sample of the rig and the estimates that belong to it, one for each tendon."""

    sample: RigSample
    estimates: tuple[online.TendonEstimate, ...]


class Memory(NamedTuple):
    """All that the slave remembers from one tick to the next."""

    session: Session
    estimators: tuple[EstimatorState, ...]
    standing: Standing
    motor: tuple[float, ...] = ()  # [m] what the gate last let through; empty = never engaged yet
    newest: Row | None = None
    following: Control = Control()
    silence: float = 0.0  # [s] since the last sample that could be used
    overload: float = 0.0  # [s] for which a tension has been far over its limit, engaged
    hindrance: str = NO_SAMPLE  # why the rig is not usable, in words; empty if it is


class Output(NamedTuple):
    """What a tick asks of the world."""

    motor: tuple[float, ...]  # [m] to be written to the rig; empty = nothing yet
    verdict: gate.Verdict
    rows: tuple[Row, ...]  # the samples that were new, oldest first


def start(prepared: Sequence[online.Prepared], starts_at_zero: bool) -> Memory:
    """Return the memory of a slave that has just started; see `Rig.starts_at_zero`."""
    states = tuple(online.initial(p) for p in prepared)
    return Memory(Session(), states, standing.start(len(prepared), starts_at_zero))


def step(
    prepared: Sequence[online.Prepared],
    config: SlaveConfig,
    memory: Memory,
    samples: Sequence[RigSample],
    command: Command | None,
    fresh: bool,
    fault: Reason,
    dt: float,
) -> tuple[Output, Memory]:
    """Advance the slave by one tick.

    Until it engages for the first time nothing is asked of the motors. From then on they are asked
    to be somewhere at every tick: where the gate let them go last, unless they are commanded on.

    Parameters
    ----------
    prepared : sequence of Prepared
        The estimator's model of each tendon.
    config : SlaveConfig
        Limits of the gate and of silence.
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
    """
    states, newest, rows = memory.estimators, memory.newest, []
    for sample in samples:
        elapsed = sample.time_s - newest.sample.time_s if newest else 0.0
        newest, states = estimate(prepared, states, sample, elapsed)
        rows.append(newest)
    silence = 0.0 if any(usable(row) for row in rows) else memory.silence + dt
    overloaded = memory.session.may_move and overload(config.gate, newest)
    after = memory._replace(
        estimators=states,
        standing=standing.step(memory.standing, samples, dt),
        newest=newest,
        silence=silence,
        overload=memory.overload + dt if overloaded else 0.0,
    )
    motor = memory.motor or standing.known(after.standing, config.silence_max)
    hindrance = NO_SAMPLE if newest is None else "" if motor else NO_POSITION
    master = session.State(command.state) if command is not None else session.State.OFF
    asks = fresh and master is session.State.ENGAGED
    asked = command.position[: len(prepared)] if command is not None and asks else ()

    side = session.step(
        memory.session,
        session.Inputs(
            usable=not hindrance,
            peer_fresh=fresh,
            peer_state=master,
            engage=session.switch_of(master),
            fault=fault if fault is not Reason.NONE else own_fault(config, after, asked),
        ),
        dt,
    )
    after = after._replace(session=side, hindrance=hindrance)
    engaged = side.may_move and asks
    if newest is None or not (memory.motor or engaged):
        return Output((), gate.Verdict.HELD, tuple(rows)), after
    wanted, following = control.step(memory.following, asked, motor, engaged)
    motor, verdict = gate.step(config.gate, motor, wanted, tension(newest), silence, engaged, dt)
    return Output(motor, verdict, tuple(rows)), after._replace(motor=motor, following=following)


def own_fault(config: SlaveConfig, memory: Memory, asked: Sequence[float]) -> Reason:
    """Return what the slave itself finds wrong; `asked` [m] is empty unless it shall move."""
    if memory.newest is not None and memory.silence > config.silence_max:
        return Reason.SAMPLES_STALE
    if memory.overload > OVERLOAD_S:
        return Reason.OVER_LIMIT
    return Reason.NONE if all(map(math.isfinite, asked)) else Reason.NOT_FINITE


def overload(limits: gate.GateConfig, newest: Row | None) -> bool:
    """Return whether a tendon pulls so hard that refusing to pull further has not helped."""
    if newest is None:
        return False
    return any(t > OVERLOAD * limits.tension_max for t in newest.sample.proximal_tension.tolist())


def refused(estimates: online.TendonEstimate) -> bool:
    """Return whether the estimator refused the sample behind its estimate."""
    return bool(estimates.status & online.Status.INVALID_INPUT)


def usable(row: Row) -> bool:
    """Return whether every tendon's sample could be used by its estimator."""
    return not any(map(refused, row.estimates))


def tension(row: Row) -> list[float]:
    """Return the tensions [N] at the housing; NaN where the sample was refused."""
    measured = row.sample.proximal_tension.tolist()
    return [math.nan if refused(e) else t for e, t in zip(row.estimates, measured, strict=True)]


def estimate(
    prepared: Sequence[online.Prepared],
    states: Sequence[EstimatorState],
    sample: RigSample,
    elapsed: float,
) -> tuple[Row, tuple[EstimatorState, ...]]:
    """Step each tendon's estimator with one sample, `elapsed` [s] after the one before."""
    tension = sample.proximal_tension.tolist()
    displacement = sample.proximal_displacement
    travel = [math.nan] * len(tension) if displacement is None else displacement.tolist()
    estimates, after = [], []
    for model, state, force, position in zip(prepared, states, tension, travel, strict=True):
        result, advanced = online.step(model, state, force, position, elapsed)
        estimates.append(result)
        after.append(advanced)
    return Row(sample, tuple(estimates)), tuple(after)
