"""Detect motors that do not follow commands, and frozen samples.

A driver that repeats its last frame looks like a rig at rest: no tension limit would ever be
reached. So bit-identical tension and travel of a tendon count as no sample once its motor has been
commanded to move.
"""

from collections.abc import Sequence
from math import isfinite, nan
from typing import Annotated

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.structs import F64, Field, Flag, Struct
from slave.fault_detection.config import FaultDetectionConfig
from slave.rig_layout import EstimatedTendon, RigLayout
from teleop.messages.messages import MAX_TENDONS
from teleop.session.state_machine import Reason


class MotorReading(Struct):
    """A tendon's newest reading."""

    tension: F64 = nan  # [N]
    displacement: F64 = nan  # [m]
    sent: F64 = nan  # [m] motor command at the first occurrence of this reading


class MotorChecks(Struct):
    """State of the motor checks."""

    has_readings: Flag = False  # False before the first motor command
    readings: Annotated[Sequence[MotorReading], Field(MotorReading, MAX_TENDONS)]
    repeated: Flag = False  # whether the reading of a commanded motor has not changed
    late: F64 = 0.0  # [s] for which the tracking error of a motor has been too large


@jit_compile
def record_motor_readings(
    motors: MotorChecks, layout: RigLayout, tendons: Sequence[EstimatedTendon], sent: Array
) -> None:
    """Process one sample: note the motor command at the first occurrence of each reading.

    A bit-identical reading keeps the noted command; without an encoder no reading counts as
    identical. `check_motors` resets the notes until the first command. `sent` [m], shape (16,), are
    the last motor commands; `motors` are changed in place.
    """
    for i in range(layout.tendons):
        tendon, reading = tendons[i], motors.readings[i]
        same_tension = tendon.tension == reading.tension
        same_displacement = tendon.displacement == reading.displacement
        if not (motors.has_readings and same_tension and same_displacement):
            reading.tension, reading.displacement = tendon.tension, tendon.displacement
            reading.sent = sent[i]
    motors.has_readings = True


@jit_compile
def check_motors(
    config: FaultDetectionConfig,
    motors: MotorChecks,
    layout: RigLayout,
    sent: Array,
    has_sent: bool,
    had_samples: bool,
    dt: float,
) -> tuple[Reason, int]:
    """Check one tick; return whether a motor does not follow its command, and which.

    The motor is counted from 0; `Reason.NONE` and -1 if all follow. Sets `motors.repeated` if the
    samples are frozen.

    `motors` are changed in place, after `record_motor_readings` for each sample of the last `dt`
    [s], if it `had_samples`. `sent` [m], shape (16,), are the last motor commands; unless it
    `has_sent` one, the state is reset.
    """
    if not has_sent:
        motors.has_readings, motors.repeated, motors.late = False, False, 0.0
        return Reason.NONE, -1
    if not motors.has_readings:
        return Reason.NONE, -1
    largest, furthest, sent_on = 0.0, 0, False
    for i in range(layout.tendons):
        reading = motors.readings[i]
        gap = abs(sent[i] - reading.displacement) if isfinite(reading.displacement) else 0.0
        if gap > largest:
            largest, furthest = gap, i
        sent_on = sent_on or abs(sent[i] - reading.sent) > config.stuck_travel
    if had_samples:
        motors.repeated = sent_on
    motors.late = motors.late + dt if largest > config.motor_lag else 0.0
    if motors.late > config.motor_lag_time:
        return Reason.MOTOR_POSITION_ERROR, furthest
    return Reason.NONE, -1
