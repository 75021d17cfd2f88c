"""Whether a load cell still measures: readings that stay the same to the last bit.

A cell with noise repeats itself with a probability p that its noise and its steps tell; n readings
alike come about with p^n. Where the model has no noise, the readings tell whether there is: one
that differs from the last more often than a cell's steps alone allow, and as often as not turns
back, is noisy. The cell is stuck when p^n is out of the question, the motor moved meanwhile, and
nothing like it was seen before. If the motor pulled and no reading was ever higher, it is more
likely saturated than stuck there by chance; at its known range it surely is. One that has never
shown a second reading is stuck once the motor has gone further than a taut tendon's backlash.
"""

from math import erf, inf, log, sqrt

from estimator.compiled import compiled
from estimator.records import F64, I64, Flag, Record
from slave.fault_detection.config import FaultDetectionConfig
from teleop.session import Reason

SURE = log(1e-12)  # of p^n: once in thirty years at 1 kHz
SUSPECT = log(1e-4)
LONGER = 5  # times the longest run of like readings before
AT_RANGE = 0.99  # of the cell's range
AT_RANGE_TIME = 0.010  # [s]

# where the model has no noise
REPEATS = 0.4  # of readings at most in a cell with noise; one that hovers at a step has a half
TURNS = 0.3  # of readings at least; noise has a half, a load that changes hardly any
ENOUGH = 100  # readings to tell

TAUT_TRAVEL = 0.002  # [m] of motor in which a taut tendon changes its tension: above its backlash


class LikeReadings(Record):
    """A run of readings that are alike; the rest means nothing unless it is `lasting`."""

    lasting: Flag = False  # not while the newest reading differs from the one before
    readings: I64 = 0
    time: F64 = 0.0  # [s] since the first
    begin: F64 = 0.0  # [m] of the motor at the first
    low: F64 = 0.0  # [m] of the motor, lowest and highest since
    high: F64 = 0.0


class LoadCell(Record):
    """What is remembered of a load cell."""

    reading: F64 = -inf  # [N] newest
    displacement: F64 = 0.0  # [m] of the motor then
    peak: F64 = -inf  # [N] highest reading that was left again
    step: F64 = inf  # [N] least difference of two readings
    longest: I64 = 1  # readings in the longest run that ended
    run: LikeReadings
    at_range: F64 = 0.0  # [s] for which the reading stands at the cell's range
    readings: I64 = 0  # until the newest that differs
    changes: I64 = 0  # of them that differ from the one before
    turns: I64 = 0  # of them that do so the other way than the one before that
    rise: F64 = 0.0  # [N] newest difference


@compiled
def check_cell(
    config: FaultDetectionConfig,
    noise: float,
    cell: LoadCell,
    tension: float,
    displacement: float,
    dt: float,
) -> Reason:
    """Take one reading; return what is wrong with the load cell, if anything.

    Parameters
    ----------
    noise : float
        Its standard deviation [N], steps included; 0 where the model has none.
    cell : LoadCell
        Changed in place.
    tension : float
        Its reading [N], finite.
    displacement : float
        Of the motor [m]; NaN without an encoder, and only the range is checked.
    dt : float
        Time since the last sample [s].
    """
    cell.at_range = cell.at_range + dt if tension >= AT_RANGE * config.cell_range else 0.0
    saturated = cell.at_range >= AT_RANGE_TIME
    if tension != cell.reading:
        _take_other_reading(cell, tension, displacement)
        return Reason.CELL_SATURATED if saturated else Reason.NONE
    _take_like_reading(cell, displacement, dt)
    if saturated:
        return Reason.CELL_SATURATED
    run = cell.run
    travel = run.high - run.low
    if cell.step == inf and tension > config.slack and travel > TAUT_TRAVEL:
        return Reason.CELL_STUCK
    lasts = run.time >= config.stuck_time and run.readings > LONGER * cell.longest
    if not (travel >= config.stuck_travel and lasts):
        return Reason.NONE
    if run_log_probability(cell, noise) > SURE:
        return Reason.NONE
    flat_top = tension >= cell.peak and displacement > run.begin
    return Reason.CELL_SATURATED if flat_top else Reason.CELL_STUCK


@compiled
def is_suspect(cell: LoadCell, noise: float) -> bool:
    """Return whether the readings have been alike for longer than noise usually lets them be."""
    return cell.run.lasting and run_log_probability(cell, noise) < SUSPECT


@compiled
def run_log_probability(cell: LoadCell, noise: float) -> float:
    """Return the logarithm of p^n for the run that lasts; 0 for a cell without noise.

    `noise` [N] is that of the model; 0 where it has none.
    """
    if not cell.run.lasting or cell.step == inf:
        return 0.0
    if noise == 0.0:
        return cell.run.readings * log(REPEATS) if is_noisy(cell) else 0.0
    variance = noise * noise - cell.step * cell.step / 12.0
    if variance <= 0.0:
        return 0.0
    repeats = erf(cell.step / sqrt(8.0 * variance))
    return cell.run.readings * log(repeats) if repeats > 0.0 else -inf


@compiled
def is_noisy(cell: LoadCell) -> bool:
    """Return whether the readings up to the run that lasts show noise of their own."""
    return (
        cell.readings >= ENOUGH
        and cell.changes >= (1.0 - REPEATS) * cell.readings
        and cell.turns >= TURNS * cell.readings
    )


@compiled
def _take_other_reading(cell: LoadCell, tension: float, displacement: float) -> None:
    """Take a reading that differs from the last: a run has ended, of one reading at least."""
    rise = tension - cell.reading
    alike = cell.run.readings if cell.run.lasting else 1
    cell.peak = max(cell.peak, cell.reading)
    cell.step = min(cell.step, abs(rise))
    cell.longest = max(cell.longest, alike)
    cell.readings += alike
    cell.changes += 1
    cell.turns += rise * cell.rise < 0.0
    cell.rise = rise
    cell.reading, cell.displacement = tension, displacement
    cell.run.lasting = False


@compiled
def _take_like_reading(cell: LoadCell, displacement: float, dt: float) -> None:
    """Take a reading that is the last one again."""
    run = cell.run
    if not run.lasting:
        run.lasting, run.readings, run.time = True, 1, 0.0
        run.begin = run.low = run.high = cell.displacement
    run.readings += 1
    run.time += dt
    run.low, run.high = min(run.low, displacement), max(run.high, displacement)
    cell.displacement = displacement
