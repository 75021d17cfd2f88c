"""The size of a bench: the diagnosis counts in units in which all benches are about as large.

Bounds of parameters, steps of fits, thresholds and tolerances of solvers are those of a bench of
about 20 N and some millimetres. A record of another size is counted in other units of force and
travel, tens or tenths of newtons and metres (or of newton metres and radians), and from another
zero of the motor's encoder. No law changes by that: K, shares, gains and times stay, and numbers
with a unit go along. Powers of ten leave the records of the usual size as they are.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from estimator.array_types import Array

REFERENCE_FORCE = 20.0  # [N] largest effort
REFERENCE_TRAVEL = 3.5e-3  # [m] range of the motor's travel

_POWERS = {"N": (1, 0), "m": (0, 1), "kg": (1, -1), "N^2": (2, 0), "m^2": (0, 2)}
"""Part of a unit -> powers of force and of travel; a time stays as it is."""


class BenchScale(NamedTuple):
    """Units of a bench, in those of its records, and its zero.

    Attributes
    ----------
    force, travel
        How much of a record's unit of effort or travel the unit is.
    zero
        Reading of the motor's encoder that counts as none, in the record's unit.
    """

    force: float = 1.0
    travel: float = 1.0
    zero: float = 0.0

    def size(self, unit: str) -> float:
        """Return how much of a unit of the record, as "m/N" or "N s/m", one of the bench is."""
        force, travel = parse_dimension(unit)
        return self.force**force * self.travel**travel

    def size_of(self, channel: str) -> float:
        """Return the same of the unit of a channel, such as `proximal_tension`."""
        return self.travel if channel.endswith("displacement") else self.force

    @property
    def inverse(self) -> "BenchScale":
        """The scale that takes a bench back."""
        return BenchScale(1.0 / self.force, 1.0 / self.travel, -self.zero / self.travel)


UNIT_SCALE = BenchScale()


def parse_dimension(unit: str) -> tuple[int, int]:
    """Return the powers of force and of travel in a unit: (-1, 1) of "m/N", (0, 0) of "of K"."""
    force = travel = 0
    for sign, side in zip((1, -1), unit.split("/"), strict=False):
        for factor in side.split(" "):
            force_power, travel_power = _POWERS.get(factor, (0, 0))
            force, travel = force + sign * force_power, travel + sign * travel_power
    return force, travel


def choose_bench_scale(efforts: Sequence[Array], travels: Sequence[Array]) -> BenchScale:
    """Return the scale of a bench.

    Without a travel, lengths are relative to an L/EA that is assumed, and the scale keeps it.

    Parameters
    ----------
    efforts : sequence of ndarray
        Of all records.
    travels : sequence of ndarray
        What drives them, the first record's first; empty where tensions do.
    """
    force = _round_to_power_of_ten(
        max(float(abs(effort).max()) for effort in efforts) / REFERENCE_FORCE
    )
    span = max((float(travel.max() - travel.min()) for travel in travels), default=0.0)
    if not span > 0.0:
        return BenchScale(force, force)
    zero = span * round(float(travels[0][0]) / span)  # whole spans: none where it counts from one
    return BenchScale(force, _round_to_power_of_ten(span / REFERENCE_TRAVEL), zero)


def _round_to_power_of_ten(ratio: float) -> float:
    return float(10.0 ** round(math.log10(ratio))) if ratio > 0.0 else 1.0
