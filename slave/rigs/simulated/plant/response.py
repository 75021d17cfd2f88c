"""Tension response of a tendon at a point: falls as the point moves towards the housing."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.compiled import jit_compile
from slave.rigs.simulated.plant.elasticity import Springs
from slave.rigs.simulated.plant.friction import Contacts


class Curve(NamedTuple):
    """Response of the housing side of a point.

    The tension is zero from `place[0]` towards the housing, piecewise linear through the corners,
    and beyond the last rises by one newton per `-ray` metres towards the tip.
    """

    place: Array  # [m] shape (corners,), falling
    tension: Array  # [N] shape (corners,), rising from zero
    ray: float  # [m/N] < 0


class Curves(NamedTuple):
    """Response curves, one per node."""

    place: Array  # [m] shape (n, room)
    tension: Array  # [N] shape (n, room)
    corners: NDArray[np.int64]  # shape (n,): number in use
    ray: Array  # [m/N] shape (n,)


class Response(NamedTuple):
    """Response of a tendon at its tip in one step, and data to recover its nodes."""

    tip: Curve
    springs: Springs
    contacts: Contacts
    slack: Array  # [m] shape (n,): position of a node without tension from the tip
    held: Array  # [N] shape (n,): on the housing's side of a sticking node
    inner: Curves  # on the housing's side of nodes with bristles


@jit_compile
def interpolate_curve(curve: Curve, place: float) -> float:
    """Return the tension [N] of a curve at `place` [m]."""
    places, tensions = curve.place, curve.tension
    after, last = 0, len(places)  # corners beyond `place`, by bisection
    while after < last:
        middle = (after + last) // 2
        if places[middle] > place:
            after = middle + 1
        else:
            last = middle
    if after == 0:
        return 0.0
    base, tension = places[after - 1], tensions[after - 1]
    if after == len(places):
        return float(tension + (place - base) / curve.ray)
    share = (place - base) / (places[after] - base)
    return float(tension + share * (tensions[after] - tension))
