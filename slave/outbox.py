"""From what a tick found to the messages that tell of it."""

import math
from collections.abc import Sequence

from estimator.sheath import Sheath
from slave.control import JointEstimate
from slave.loop import Row
from slave.rig import Array
from teleop import messages
from teleop.coupling import Side
from teleop.messages import MAX_JOINTS, MAX_SECTIONS, MAX_TENDONS, PROFILE_POINTS, padded
from teleop.session import Session

_MISSING = (math.nan,) * MAX_TENDONS


def slave_state(
    side: Session,
    echo_stamp_ns: int,
    joints: Sequence[JointEstimate],
    sample_age: float,
    port: Side,
    signature: int,
) -> messages.SlaveState:
    """Return the state of a tick.

    `joints` are what is known of them, none before the first sample; `sample_age` [s] is the time
    since the newest sample that could be used; `signature` is that of the coupling whose `port`
    this is.
    """
    return messages.SlaveState(
        state=side.state,
        reason=side.reason,
        joints=len(joints),
        echo_stamp_ns=echo_stamp_ns,
        sample_age_ns=round(sample_age * 1e9) if joints else 0,
        position=padded([joint.position for joint in joints], MAX_JOINTS),
        force=padded([joint.force for joint in joints], MAX_JOINTS),
        force_low=padded([joint.low for joint in joints], MAX_JOINTS),
        force_high=padded([joint.high for joint in joints], MAX_JOINTS),
        status=_flags([joint.status for joint in joints], MAX_JOINTS),
        stops=side.stops,
        coupling=signature,
        energy=port.energy,
        wave=port.wave,
    )


def tendon_state(row: Row, motor: Sequence[float]) -> messages.TendonState:
    """Return one sample with its estimates, and the motor positions [m] asked for, if any were."""
    sample, estimates = row.sample, row.estimates
    return messages.TendonState(
        tendons=len(estimates),
        time_s=sample.time_s,
        proximal_tension=_array(sample.proximal_tension),
        proximal_displacement=_array(sample.proximal_displacement),
        commanded_displacement=padded(motor, MAX_TENDONS) if motor else _MISSING,
        distal_tension=padded([e.distal_tension for e in estimates], MAX_TENDONS),
        distal_tension_low=padded([e.low for e in estimates], MAX_TENDONS),
        distal_tension_high=padded([e.high for e in estimates], MAX_TENDONS),
        elongation=padded([e.elongation for e in estimates], MAX_TENDONS),
        front=padded([e.front for e in estimates], MAX_TENDONS),
        phase=_flags([e.phase for e in estimates], MAX_TENDONS),
        status=_flags([e.status for e in estimates], MAX_TENDONS),
        bench_distal_tension=_array(sample.bench_distal_tension),
        bench_distal_displacement=_array(sample.bench_distal_displacement),
    )


def tension_profile(
    tendon: int, length: float, front: float, tension: Sequence[float]
) -> messages.TensionProfile:
    """Return T(x) of one tendon at `PROFILE_POINTS` evenly spread points."""
    return messages.TensionProfile(
        tendon=tendon, length=length, front=front, tension=padded(tension, PROFILE_POINTS)
    )


def sheath(tendon: int, joint: int, model: Sheath) -> messages.Sheath:
    """Return the shape and constants of one sheath of at most `MAX_SECTIONS` sections."""
    sections = model.sections
    return messages.Sheath(
        tendon=tendon,
        joint=joint,
        sections=len(sections),
        effective_friction=model.K,
        axial_stiffness=model.axial_stiffness,
        section_length=padded([s.length for s in sections], MAX_SECTIONS),
        section_radius=padded([s.radius for s in sections], MAX_SECTIONS),
    )


def _flags(values: Sequence[int], size: int) -> tuple[int, ...]:
    return (*values, *(0,) * (size - len(values)))


def _array(values: Array | None) -> tuple[float, ...]:
    return _MISSING if values is None else padded(values.tolist(), MAX_TENDONS)
