"""How stiff the housing's tension says a tendon is: the way an end stop is felt.

A joint that moves freely lets the motor go far for little tension; against its stop every further
millimetre stretches the tendon. What tells them apart is the slope of tension over motor travel, so
it is the one thing remembered: a straight line through the latest `window` of travel, older travel
forgotten exponentially. No single sample decides, and a motor that rests changes nothing.
"""

import math
from typing import NamedTuple

_FULL = 0.1  # of the window's own spread: with less travel behind it a slope says nothing


class Trend(NamedTuple):
    """Weighted means and moments of travel [m] and tension [N]; weights fade over `window`."""

    travel: float
    tension: float
    variance: float = 0.0  # [m^2] of travel
    covariance: float = 0.0  # [m N]
    newest: float = math.nan  # [m] travel of the newest sample taken in


def start(travel: float, tension: float) -> Trend:
    """Return the trend of a single sample."""
    return Trend(travel, tension, newest=travel)


def update(trend: Trend, travel: float, tension: float, direction: float, window: float) -> Trend:
    """Take one sample in; `direction` is +1 while pulling and -1 while releasing.

    It weighs as much as the travel since the newest one, so neither speed nor rate count; one that
    went nowhere, or back, is left out.
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


def stiffness(trend: Trend, window: float) -> float:
    """Return dT/dq [N/m], infinite while there is too little travel to tell."""
    if trend.variance < (_FULL * window) ** 2:
        return math.inf
    return trend.covariance / trend.variance
