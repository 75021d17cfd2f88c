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
from slave import control, gate
from slave.config import SlaveConfig
from slave.control import Control
from slave.rig import RigSample
from teleop import session
from teleop.messages import Command
from teleop.session import Reason, Session

EstimatorState = NDArray[np.float64]


class Row(NamedTuple):
    """One sample of the rig and the estimates that belong to it, one for each tendon."""

    sample: RigSample
    estimates: tuple[online.TendonEstimate, ...]


class Memory(NamedTuple):
    """All that the slave remembers from one tick to the next."""

    session: Session
    estimators: tuple[EstimatorState, ...]
    motor: tuple[float, ...] = ()  # [m] what the gate last let through; empty before any sample
    newest: Row | None = None
    following: Control = Control()
    silence: float = 0.0  # [s] since the last sample that could be used


class Output(NamedTuple):
    """What a tick asks of the world."""

    motor: tuple[float, ...]  # [m] to be written to the rig; empty = nothing yet
    verdict: gate.Verdict
    rows: tuple[Row, ...]  # the samples that were new, oldest first


def start(prepared: Sequence[online.Prepared]) -> Memory:
    """Return the memory of a slave that has just started."""
    return Memory(Session(), tuple(online.initial(p) for p in prepared))


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
        What is wrong on this side now; `Reason.NONE` if nothing.
    dt : float
        Time since the last tick [s].
    """
    states, newest, rows = memory.estimators, memory.newest, []
    for sample in samples:
        elapsed = sample.time_s - newest.sample.time_s if newest else 0.0
        newest, states = estimate(prepared, states, sample, elapsed)
        rows.append(newest)
    silence = 0.0 if any(usable(row) for row in rows) else memory.silence + dt
    if fault is Reason.NONE and newest is not None and silence > config.silence_max:
        fault = Reason.SAMPLES_STALE

    side = session.step(
        memory.session,
        session.Inputs(
            usable=newest is not None,
            peer_fresh=fresh,
            peer_state=session.State(command.state) if command else session.State.OFF,
            engage=command is not None and command.state == session.State.ENGAGED,
            fault=fault,
        ),
        dt,
    )
    if newest is None:
        return Output((), gate.Verdict.HELD, ()), Memory(side, states, silence=silence)
    standing = memory.motor or motor_position(newest.sample)
    engaged = side.may_move and fresh and command is not None
    target = command.position[: len(standing)] if command else standing
    wanted, controller = control.step(memory.following, target, standing, engaged)
    tension = newest.sample.proximal_tension.tolist()
    motor, verdict = gate.step(config.gate, standing, wanted, tension, engaged, dt)
    after = Memory(side, states, motor, newest, controller, silence)
    return Output(motor, verdict, tuple(rows)), after


def usable(row: Row) -> bool:
    """Return whether every tendon's sample could be used by its estimator."""
    return not any(e.status & online.Status.INVALID_INPUT for e in row.estimates)


def motor_position(sample: RigSample) -> tuple[float, ...]:
    """Return where the motors stand [m] by the encoders; zero where there is none to tell."""
    displacement = sample.proximal_displacement
    if displacement is None:
        return (0.0,) * len(sample.proximal_tension)
    return tuple(q if math.isfinite(q) else 0.0 for q in displacement.tolist())


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
