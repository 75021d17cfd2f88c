"""Units of a record, linear or rotary, and quantities in them.

The mathematics counts in newtons and metres. A rotary record (torque, angle) is brought there by a
reference radius r, force = torque/r and travel = r angle, which changes no law: K, times and shares
stay, L/EA becomes r^2 times as large. r is not the pulley's, which such a record does not tell; it
is chosen so that numbers are of usual size. What is reported is in the record's own units again.
"""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array

TRAVEL_OVER_FORCE = 1e-3  # [m/N] that an angle of 1 rad over the largest torque becomes


class Units(NamedTuple):
    """Units of effort and travel.

    Attributes
    ----------
    effort, travel
        "N" and "m", or "N m" and "rad".
    signed
        Whether effort may have either sign: a torque or a force, but no tension.
    radius
        Reference radius [m]; 1 for a linear record, 0 for a rotary one before it is chosen.
    """

    effort: str
    travel: str
    signed: bool
    radius: float = 1.0

    @property
    def rotary(self) -> bool:
        """Whether effort is a torque and travel an angle."""
        return self.travel == "rad"

    def of(self, channel: str) -> str:
        """Return the unit of a channel, such as `proximal_tension`."""
        return self.travel if channel.endswith("displacement") else self.effort

    @staticmethod
    def base(channel: str) -> str:
        """Return the unit that the mathematics counts a channel in."""
        return "m" if channel.endswith("displacement") else "N"

    def word(self, channel: str) -> str:
        """Return what a channel is called: "torque at the housing"."""
        end, _, what = channel.partition("_")
        words = _WORDS[(self.rotary, self.signed)]
        return f"{words[what == 'displacement']} at the {_ENDS[end]}"

    def size(self, unit: str) -> float:
        """Return how much of a record's unit one of newtons and metres is: 1 N is r N m.

        `unit` is composed of N, m, kg, s and others, as "m/N" or "N s/m".
        """
        return self.radius ** self._power(unit)

    def name(self, unit: str) -> str:
        """Return what a unit of newtons and metres is in the record: "m/N" is "rad/(N m)"."""
        if not self.rotary or self._power(unit) == 0:
            return unit
        above, _, below = unit.partition("/")
        parts = [
            " ".join(_ROTARY.get(one, one) for one in side.split(" ")) for side in (above, below)
        ]
        if not below:
            return parts[0]
        return f"{parts[0]}/({parts[1]})" if " " in parts[1] else "/".join(parts)

    def _power(self, unit: str) -> int:
        if not self.rotary:
            return 0
        above, _, below = unit.partition("/")
        return sum(_POWERS.get(one, 0) for one in above.split(" ")) - sum(
            _POWERS.get(one, 0) for one in below.split(" ")
        )

    def inward(self, channel: str, signal: Array) -> Array:
        """Return a signal of the record in newtons or metres, (n,)."""
        return signal / self.size(self.base(channel))

    def outward(self, channel: str, signal: Array) -> Array:
        """Return a signal in newtons or metres in the record's units, (n,)."""
        return signal * self.size(self.base(channel))

    def scaled_to(self, efforts: Iterable[Array]) -> "Units":
        """Return the units with the reference radius for efforts up to their largest [effort]."""
        if not self.rotary:
            return self
        most = max(float(np.abs(effort).max()) for effort in efforts)
        return self._replace(radius=math.sqrt(TRAVEL_OVER_FORCE * max(most, 1e-9)))


LINEAR = Units("N", "m", signed=False)
"""Tension and travel of a tendon."""

FORCE = Units("N", "m", signed=True)
"""Force of either sign, and travel: a closed loop between linear drives."""

ROTARY = Units("N m", "rad", signed=True, radius=0.0)
"""Torque and angle at pulleys."""

_ENDS = {"proximal": "housing", "distal": "tip"}
_WORDS = {
    (False, False): ("tension", "travel"),
    (False, True): ("force", "travel"),
    (True, True): ("torque", "angle"),
}
_POWERS = {"N": 1, "m": -1, "kg": 2, "m^2": -2, "N^2": 2}
_ROTARY = {"N": "N m", "m": "rad", "kg": "kg m^2", "N^2": "(N m)^2"}


def quantity(value: float | None, unit: str, digits: int = 4) -> str:
    """Return a value as one says it: with a prefix where the unit is too large."""
    if value is None:
        return ""
    if unit.partition("/")[0] in ("m", "rad", "N m") and abs(value) < 0.1:
        small = abs(value) < 1e-4
        return f"{value * (1e6 if small else 1e3):.{digits}g} {'µ' if small else 'm'}{unit}"
    return f"{value:.{digits}g} {unit}".rstrip()
