"""Low-pass filtered tension and travel of a tendon, against noise."""

from math import isfinite, nan

from estimator.compiled import jit_compile
from estimator.records import F64, Struct

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
    moved = share * (displacement - average.displacement)
    average.tension += share * (tension - average.tension)
    average.displacement += moved
    average.speed += share * (moved / dt - average.speed)
