"""Local stiffness of a tendon from tension over motor travel, to detect an end stop.

While the joint moves freely the tension hardly rises with motor travel; at the stop every
millimetre stretches the tendon. The slope is that of a straight line fitted to the latest `window`
of travel, older travel with exponentially decaying weight. No single sample decides, and a resting
motor changes nothing.
"""

import math
from typing import NamedTuple

_SPREAD_MIN = 0.1  # of the window's own spread: with less travel the slope is not defined


class Trend(NamedTuple):
    """Weighted means and moments of travel [m] and tension [N]; weights decay over `window`."""

    travel: float
    tension: float
    variance: float = 0.0  # [m^2] of travel
    covariance: float = 0.0  # [m N]
    newest: float = math.nan  # [m] travel of the newest sample used


def init_trend(travel: float, tension: float) -> Trend:
    """Return the trend of a single sample."""
    return Trend(travel, tension, newest=travel)


def update_trend(
    trend: Trend, travel: float, tension: float, direction: float, window: float
) -> Trend:
    """Return the trend after a sample; `direction` is +1 while pulling and -1 while releasing.

    Its weight is the travel since the last one, so speed and rate do not matter; samples without
    forward travel are ignored.
    """
    gone = direction * (travel - trend.newest)
    if not gone > 0.0:
        return trend
    weight = -math.expm1(-gone / window)
    dq, dT = travel - trend.travel, tension - trend.tension
    return Trend(
        trend.travel + weight * dq,
        trend.tension + weight * dT,
        (1.0 - weight) * (trend.variance + weight * dq * dq),
        (1.0 - weight) * (trend.covariance + weight * dq * dT),
        travel,
    )


def compute_stiffness(trend: Trend, window: float) -> float:
    """Return dT/dq [N/m], infinite while there is too little travel."""
    if trend.variance < (_SPREAD_MIN * window) ** 2:
        return math.inf
    return trend.covariance / trend.variance
