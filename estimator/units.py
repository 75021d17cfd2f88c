"""Units of a record, linear or rotary, and quantities in them.

The diagnosis speaks of tension and travel, in newtons and metres, whatever the record: torque and
angle are as good, since no law changes by them (estimator.diagnosis.record). Here numbers
get the record's own units and words.
"""

from typing import NamedTuple


class Units(NamedTuple):
    """Units of effort and travel.

    Attributes
    ----------
    effort, travel
        "N" and "m", or "N m" and "rad".
    signed
        Whether effort may have either sign: a torque or a force, but no tension.
    """

    effort: str
    travel: str
    signed: bool

    @property
    def rotary(self) -> bool:
        """Whether effort is a torque and travel an angle."""
        return self.travel == "rad"

    def get_unit(self, channel: str) -> str:
        """Return the unit of a channel, such as `proximal_tension`."""
        return self.travel if channel.endswith("displacement") else self.effort

    def name_channel(self, channel: str) -> str:
        """Return what a channel is called: "torque at the housing"."""
        end, _, quantity = channel.partition("_")
        words = _WORDS[(self.rotary, self.signed)]
        return f"{words[quantity == 'displacement']} at the {_ENDS[end]}"

    def name_unit(self, unit: str) -> str:
        """Return what a unit of newtons and metres is in the record: "m/N" is "rad/(N m)"."""
        if not self.rotary:
            return unit
        numerator, _, denominator = unit.partition("/")
        parts = [
            " ".join(_ROTARY.get(factor, factor) for factor in side.split(" "))
            for side in (numerator, denominator)
        ]
        if not denominator:
            return parts[0]
        return f"{parts[0]}/({parts[1]})" if " " in parts[1] else "/".join(parts)


LINEAR = Units("N", "m", signed=False)
"""Tension and travel of a tendon."""

FORCE = Units("N", "m", signed=True)
"""Force of either sign, and travel: a closed loop between linear drives."""

ROTARY = Units("N m", "rad", signed=True)
"""Torque and angle at pulleys."""

_ENDS = {"proximal": "housing", "distal": "tip"}
_WORDS = {
    (False, False): ("tension", "travel"),
    (False, True): ("force", "travel"),
    (True, True): ("torque", "angle"),
}
_ROTARY = {"N": "N m", "m": "rad", "kg": "kg m^2", "N^2": "(N m)^2"}


def format_quantity(value: float | None, unit: str, digits: int = 4) -> str:
    """Return a value as one says it: with a prefix where the unit is too large."""
    if value is None:
        return ""
    if unit.partition("/")[0] in ("m", "rad", "N m") and abs(value) < 0.1:
        small = abs(value) < 1e-4
        return f"{value * (1e6 if small else 1e3):.{digits}g} {'µ' if small else 'm'}{unit}"
    return f"{value:.{digits}g} {unit}".rstrip()
