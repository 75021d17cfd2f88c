"""How a tendon answers at a point: with a tension that falls as the point moves to the housing."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.compiled import compiled
from slave.rigs.simulated.plant.elasticity import Springs
from slave.rigs.simulated.plant.friction import Contacts


class Curve(NamedTuple):
    """How everything on the housing's side of a point answers there.

    The tension is zero from `place[0]` towards the housing, runs through the corners, and rises
    for ever by one newton each `-ray` metres towards the tip.
    """

    place: Array  # [m] shape (corners,), falling
    tension: Array  # [N] shape (corners,), rising from zero
    ray: float  # [m/N] < 0


class Curves(NamedTuple):
    """Many curves, one a node."""

    place: Array  # [m] shape (n, room)
    tension: Array  # [N] shape (n, room)
    corners: NDArray[np.int64]  # shape (n,): how much of the room is used
    ray: Array  # [m/N] shape (n,)


class Response(NamedTuple):
    """How a tendon answers at its tip in one step, and what it takes to find its nodes then."""

    tip: Curve
    springs: Springs
    contacts: Contacts
    slack: Array  # [m] shape (n,): where a node rests while nothing pulls it from the tip
    held: Array  # [N] shape (n,): on the housing's side of a node that grips, while it stays
    inner: Curves  # on the housing's side of nodes that lean


@compiled
def tension_on(curve: Curve, place: float) -> float:
    """Return the tension [N] of a curve at `place` [m]."""
    places, tensions = curve.place, curve.tension
    after, last = 0, len(places)  # corners beyond `place`, found by halving
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
