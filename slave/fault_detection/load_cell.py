"""Detect a stuck or saturated load cell: readings identical to the last bit.

A cell with noise repeats a reading with a probability p given by noise and resolution; n identical
readings have probability p^n. If the model has no noise, it is detected from the readings: changes
more frequent than the resolution alone explains, with frequent sign changes. The cell is stuck if
p^n is negligible, the motor moved meanwhile, and the run is longer than any before. If the motor
pulled and no reading was ever higher, it is reported as saturated; so is a constant reading at the
known range. A cell that has only ever shown one reading is stuck once the motor has moved further
than a taut tendon's backlash.
"""

from math import erf, inf, isfinite, log, nan, sqrt

from estimator.compiled import jit_compile
from estimator.structs import F64, I64, Flag, Struct
from slave.fault_detection.config import FaultDetectionConfig
from teleop.session.state_machine import Reason

# --- low-pass filtered tension and travel of a tendon, against noise

TIME_CONSTANT = 0.005  # [s] of the averages


class TendonAverage(Struct):
    """One tendon, averaged; NaN before its first sample."""

    tension: F64 = nan  # [N]
    displacement: F64 = nan  # [m]
    speed: F64 = nan  # [m/s]


@jit_compile
def update_average(average: TendonAverage, tension: float, displacement: float, dt: float) -> None:
    """Update the averages with a sample `dt` [s] after the last; NaN averages are initialised."""
    if not isfinite(average.displacement):
        average.tension, average.displacement, average.speed = tension, displacement, 0.0
        return
    if not dt > 0.0:
        return
    share = dt / (dt + TIME_CONSTANT)
    displacement_step = share * (displacement - average.displacement)
    average.tension += share * (tension - average.tension)
    average.displacement += displacement_step
    average.speed += share * (displacement_step / dt - average.speed)


LOG_PROBABILITY_FAULT = log(1e-12)  # of p^n: once in thirty years at 1 kHz
LOG_PROBABILITY_SUSPECT = log(1e-4)
RUN_LENGTH_RATIO = 5  # times the longest earlier run of identical readings
RANGE_SHARE = 0.99  # of the cell's range
RANGE_TIME = 0.010  # [s]

# if the model has no noise
# fraction of repeated readings in a noisy cell, at most; one half between two steps
REPEAT_SHARE_MAX = 0.4
# fraction of sign changes, at least; one half for noise, hardly any for a changing load
TURN_SHARE_MIN = 0.3
NOISE_READINGS_MIN = 100  # least readings for the noise test

# [m] of motor travel that changes the tension of a taut tendon: above its backlash
TAUT_TRAVEL = 0.002


class ConstantRun(Struct):
    """A run of identical readings; the other fields are valid only if `lasting`."""

    lasting: Flag = False  # False if the newest reading differs from the one before
    readings: I64 = 0
    time: F64 = 0.0  # [s] since the first
    begin: F64 = 0.0  # [m] of the motor at the first
    low: F64 = 0.0  # [m] of the motor, lowest and highest since
    high: F64 = 0.0


class LoadCell(Struct):
    """State of a load cell's check."""

    reading: F64 = -inf  # [N] newest
    displacement: F64 = 0.0  # [m] of the motor then
    peak: F64 = -inf  # [N] highest reading followed by another one
    step: F64 = inf  # [N] least difference of two readings
    longest: I64 = 1  # readings in the longest run that ended
    run: ConstantRun
    at_range: F64 = 0.0  # [s] for which the reading stands at the cell's range
    readings: I64 = 0  # until the newest that differs
    changes: I64 = 0  # of them that differ from the one before
    turns: I64 = 0  # of them with a sign opposite to the change before
    rise: F64 = 0.0  # [N] newest difference


@jit_compile
def check_cell(
    config: FaultDetectionConfig,
    noise: float,
    cell: LoadCell,
    tension: float,
    displacement: float,
    dt: float,
) -> Reason:
    """Process one reading; return the fault of the load cell, or `Reason.NONE`.

    Parameters
    ----------
    noise : float
        Standard deviation [N], quantisation included; 0 if the model has none.
    cell : LoadCell
        Changed in place.
    tension : float
        Its reading [N], finite.
    displacement : float
        Of the motor [m]; NaN without an encoder, and only the range is checked.
    dt : float
        Time since the last sample [s].
    """
    cell.at_range = cell.at_range + dt if tension >= RANGE_SHARE * config.cell_range else 0.0
    saturated = cell.at_range >= RANGE_TIME
    if tension != cell.reading:
        _process_other_reading(cell, tension, displacement)
        return Reason.CELL_SATURATED if saturated else Reason.NONE
    _process_equal_reading(cell, displacement, dt)
    if saturated:
        return Reason.CELL_SATURATED
    run = cell.run
    travel = run.high - run.low
    if cell.step == inf and tension > config.slack and travel > TAUT_TRAVEL:
        return Reason.CELL_STUCK
    lasts = run.time >= config.stuck_time and run.readings > RUN_LENGTH_RATIO * cell.longest
    if not (travel >= config.stuck_travel and lasts):
        return Reason.NONE
    if compute_run_log_probability(cell, noise) > LOG_PROBABILITY_FAULT:
        return Reason.NONE
    flat_top = tension >= cell.peak and displacement > run.begin
    return Reason.CELL_SATURATED if flat_top else Reason.CELL_STUCK


@jit_compile
def is_suspect(cell: LoadCell, noise: float) -> bool:
    """Return whether the readings have been identical for longer than noise explains."""
    return cell.run.lasting and compute_run_log_probability(cell, noise) < LOG_PROBABILITY_SUSPECT


@jit_compile
def compute_run_log_probability(cell: LoadCell, noise: float) -> float:
    """Return ln p^n of the current run; 0 for a cell without noise.

    `noise` [N] is that of the model, 0 if none.
    """
    if not cell.run.lasting or cell.step == inf:
        return 0.0
    if noise == 0.0:
        return cell.run.readings * log(REPEAT_SHARE_MAX) if is_noisy(cell) else 0.0
    variance = noise * noise - cell.step * cell.step / 12.0
    if variance <= 0.0:
        return 0.0
    repeats = erf(cell.step / sqrt(8.0 * variance))
    return cell.run.readings * log(repeats) if repeats > 0.0 else -inf


@jit_compile
def is_noisy(cell: LoadCell) -> bool:
    """Return whether the readings before the current run show noise."""
    return (
        cell.readings >= NOISE_READINGS_MIN
        and cell.changes >= (1.0 - REPEAT_SHARE_MAX) * cell.readings
        and cell.turns >= TURN_SHARE_MIN * cell.readings
    )


@jit_compile
def _process_other_reading(cell: LoadCell, tension: float, displacement: float) -> None:
    """Process a reading that differs from the last: a run has ended."""
    rise = tension - cell.reading
    repeats = cell.run.readings if cell.run.lasting else 1
    cell.peak = max(cell.peak, cell.reading)
    cell.step = min(cell.step, abs(rise))
    cell.longest = max(cell.longest, repeats)
    cell.readings += repeats
    cell.changes += 1
    cell.turns += rise * cell.rise < 0.0
    cell.rise = rise
    cell.reading, cell.displacement = tension, displacement
    cell.run.lasting = False


@jit_compile
def _process_equal_reading(cell: LoadCell, displacement: float, dt: float) -> None:
    """Process a reading identical to the last one."""
    run = cell.run
    if not run.lasting:
        run.lasting, run.readings, run.time = True, 1, 0.0
        run.begin = run.low = run.high = cell.displacement
    run.readings += 1
    run.time += dt
    run.low, run.high = min(run.low, displacement), max(run.high, displacement)
    cell.displacement = displacement
