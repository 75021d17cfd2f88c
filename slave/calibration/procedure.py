"""The initialisation of one joint, as a pure function of the measurements at the housing.

After Phee et al. 2009, section III, for each tendon of the joint in turn: take up all tendons, pull
one at constant speed while the other is paid out at a small tension, detect the end stop by the
slope of the tension, pull on to a chosen tension, slacken the other tendon, release to a low
tension, and pull and release again. The joint rests against its stop throughout, so motor travel is
elongation. Then the other tendon. On the way back to mid-range follow the drags, which the paper
does not have: one tendon draws the other out while both tensions rise and fall.

`step` returns the next motor positions. It uses tension and motor travel only, and aborts on any
inconsistency: the tendons are then released to a low tension, and nothing is pulled any more.
"""

import math

from slave.calibration import procedure_state
from slave.calibration.config import InitialiseConfig
from slave.calibration.phases import HANDLERS, is_settled
from slave.calibration.procedure_state import (
    CellState,
    JointConstants,
    JointReadings,
    Phase,
    ProcedureRefused,
    ProcedureState,
    Tendons,
    abort_procedure,
    begin_phase,
    format_tendon_name,
)
from slave.gate import GateFlags

SMOOTH_S = 0.005  # [s] time constant of the averaged tension used for decisions
BLOCKED_S = 0.2  # [s] for which the gate may block all motion

_END_PHASES = (Phase.DONE, Phase.RELAX, Phase.REFUSED)


def step(
    config: InitialiseConfig,
    joint: JointConstants,
    memory: ProcedureState,
    sample: JointReadings,
    dt: float,
) -> tuple[Tendons, ProcedureState]:
    """Return the motor targets of the joint [m] and the new state, `dt` [s] after the last tick.

    `memory` is `ProcedureState()` to begin with; the readings are the newest, all finite.
    """
    memory = _update_readings(config, memory, sample, dt)
    try:
        if memory.phase not in _END_PHASES:
            _require_progress(config, joint, memory, sample)
        speeds, memory = HANDLERS[memory.phase](config, joint, memory, sample)
    except ProcedureRefused as refused:
        speeds = (0.0,) * len(sample.motor)
        memory = abort_procedure(memory, sample, str(refused))
    moves = tuple(speed * dt for speed in speeds)
    targets = tuple(m + d for m, d in zip(sample.motor, moves, strict=True))
    return targets, memory._replace(moved=moves, before=sample.motor)


def _update_readings(
    config: InitialiseConfig, memory: ProcedureState, sample: JointReadings, dt: float
) -> ProcedureState:
    """Update the state with the readings of a tick."""
    if not memory.tension:
        cells = tuple(CellState() for _ in sample.tension)
        memory = memory._replace(tension=sample.tension, cells=cells)
        memory = begin_phase(memory, memory.phase, sample)
    share = -math.expm1(-dt / SMOOTH_S)
    tension = tuple(
        was + share * (now - was) for was, now in zip(memory.tension, sample.tension, strict=True)
    )
    k = memory.side % len(sample.tension)  # the pulled tendon
    return memory._replace(
        tension=tension,
        elapsed=memory.elapsed + dt,
        steady=memory.steady + dt if is_settled(config, memory.phase, tension) else 0.0,
        highest=max(memory.highest, tension[k]),
        lowest=min(memory.lowest, sample.travel[1 - k]) if len(tension) > 1 else math.inf,
        cells=tuple(
            map(procedure_state.update_cell_state, memory.cells, sample.tension, sample.travel)
        )
        if sample.fresh
        else memory.cells,
        blocked=_update_blocked_times(memory, sample, dt),
    )


def _update_blocked_times(memory: ProcedureState, sample: JointReadings, dt: float) -> Tendons:
    """Return for how long [s] each motor was commanded to move but did not."""
    if not memory.moved:
        return memory.blocked
    return tuple(
        time + dt if requested != 0.0 and now == was else 0.0
        for time, requested, now, was in zip(
            memory.blocked, memory.moved, sample.motor, memory.before, strict=True
        )
    )


def _require_progress(
    config: InitialiseConfig, joint: JointConstants, memory: ProcedureState, sample: JointReadings
) -> None:
    """Raise `ProcedureRefused` for what ends any phase."""
    count = len(sample.tension)
    if memory.elapsed > config.phase_max:
        raise ProcedureRefused(
            f"joint {joint.number}: {memory.phase.text} took longer than {config.phase_max:g} s; "
            "check what blocks it, or raise slave.initialise.phase_max"
        )
    for k in range(count):
        name = format_tendon_name(joint.number, count, k)
        if memory.blocked[k] > BLOCKED_S:
            raise ProcedureRefused(f"{name}: {_explain_blocked_motor(memory, sample.verdict, k)}")
        behind = abs(sample.motor[k] - sample.travel[k])
        if behind > config.lag_max:
            raise ProcedureRefused(
                f"{name}: the motor is {behind * 1e3:.1f} mm behind its command at "
                f"{sample.tension[k]:.1f} N; check that it can pull {config.tension:g} N, or lower "
                "slave.initialise.tension"
            )


def _explain_blocked_motor(memory: ProcedureState, verdict: GateFlags, k: int) -> str:
    """Return which limit of the gate blocks a motor, and what to do."""
    if GateFlags.TENSION in verdict:
        return "the tension is at slave.gate.tension_max; lower slave.initialise.tension"
    if GateFlags.STALE_TENSION in verdict:
        return "its tension is older than slave.gate.tension_age_max; check the load cell"
    limit = "displacement_min" if memory.moved[k] < 0.0 else "displacement_max"
    if memory.phase is not Phase.SEEK:
        return f"its motor is at slave.gate.{limit}: widen the limit"
    return f"no stop found before slave.gate.{limit}: check that it exists, or widen the limit"
