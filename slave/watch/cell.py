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
from typing import NamedTuple

from slave.watch.config import WatchConfig
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

NEVER = 0.002  # [m] of motor in which a taut tendon changes its tension: above its backlash


class Run(NamedTuple):
    """Readings that are alike."""

    readings: int
    time: float  # [s] since the first
    begin: float  # [m] of the motor at the first
    low: float  # [m] of the motor, lowest and highest since
    high: float


class Cell(NamedTuple):
    """What is remembered of a load cell."""

    reading: float = -inf  # [N] newest
    displacement: float = 0.0  # [m] of the motor then
    peak: float = -inf  # [N] highest reading that was left again
    step: float = inf  # [N] least difference of two readings
    longest: int = 1  # readings in the longest run that ended
    run: Run | None = None  # none while the newest reading differs from the one before
    at_range: float = 0.0  # [s] for which the reading stands at the cell's range
    readings: int = 0  # until the newest that differs
    changes: int = 0  # of them that differ from the one before
    turns: int = 0  # of them that do so the other way than the one before that
    rise: float = 0.0  # [N] newest difference


def watch_cell(
    config: WatchConfig, noise: float, cell: Cell, tension: float, displacement: float, dt: float
) -> tuple[Reason, Cell]:
    """Return what is wrong with a load cell, if anything, and the new memory.

    Parameters
    ----------
    noise : float
        Its standard deviation [N], steps included.
    tension : float
        Its reading [N], finite.
    displacement : float
        Of the motor [m]; NaN without an encoder, and only the range is watched.
    dt : float
        Time since the last sample [s].
    """
    last, before, run = cell.reading, cell.displacement, cell.run
    at_range = cell.at_range + dt if tension >= AT_RANGE * config.cell_range else 0.0
    saturated = at_range >= AT_RANGE_TIME
    if tension != last:
        rise = tension - last
        alike = run.readings if run else 1
        cell = Cell(
            tension,
            displacement,
            max(cell.peak, last),
            min(cell.step, abs(rise)),
            max(cell.longest, alike),
            None,
            at_range,
            cell.readings + alike,
            cell.changes + 1,
            cell.turns + (rise * cell.rise < 0.0),
            rise,
        )
        return Reason.CELL_SATURATED if saturated else Reason.NONE, cell
    if run is None:
        run = Run(1, 0.0, before, before, before)
    low, high = min(run.low, displacement), max(run.high, displacement)
    run = Run(run.readings + 1, run.time + dt, run.begin, low, high)
    cell = cell._replace(displacement=displacement, run=run, at_range=at_range)
    if saturated:
        return Reason.CELL_SATURATED, cell
    moved = run.high - run.low >= config.stuck_travel
    if cell.step == inf and tension > config.slack and run.high - run.low > NEVER:
        return Reason.CELL_STUCK, cell
    if not (moved and run.time >= config.stuck_time and run.readings > LONGER * cell.longest):
        return Reason.NONE, cell
    if chance(cell, noise) > SURE:
        return Reason.NONE, cell
    flat_top = tension >= cell.peak and displacement > run.begin
    return Reason.CELL_SATURATED if flat_top else Reason.CELL_STUCK, cell


def suspect(cell: Cell, noise: float) -> bool:
    """Return whether the readings have been alike for longer than noise usually lets them be."""
    return cell.run is not None and chance(cell, noise) < SUSPECT


def chance(cell: Cell, noise: float) -> float:
    """Return the logarithm of p^n for the run that lasts; 0 for a cell without noise.

    `noise` [N] is that of the model; 0 where it has none.
    """
    if cell.run is None or cell.step == inf:
        return 0.0
    if noise == 0.0:
        return cell.run.readings * log(REPEATS) if noisy(cell) else 0.0
    variance = noise * noise - cell.step * cell.step / 12.0
    if variance <= 0.0:
        return 0.0
    repeats = erf(cell.step / sqrt(8.0 * variance))
    return cell.run.readings * log(repeats) if repeats > 0.0 else -inf


def noisy(cell: Cell) -> bool:
    """Return whether the readings up to the run that lasts show noise of their own."""
    return (
        cell.readings >= ENOUGH
        and cell.changes >= (1.0 - REPEATS) * cell.readings
        and cell.turns >= TURNS * cell.readings
    )
