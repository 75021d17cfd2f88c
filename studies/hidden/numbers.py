"""The numbers of a hidden bench, under the names by which a diagnosis gives them."""

import math
from typing import NamedTuple

WITHIN = 0.1  # of itself, a number is right
ANGLES = ("sine", "cosine")


class Checked(NamedTuple):
    """A number that was hidden, and as it was found, with its 95 % interval."""

    name: str
    true: float
    found: float
    low: float
    high: float

    @property
    def right(self):
        """Whether it is within 10 %, or inside its interval."""
        return abs(self.found - self.true) <= WITHIN * abs(self.true) or (
            self.low <= self.true <= self.high
        )


def checked(made, found):
    """Return the numbers of a bench and its effects that a diagnosis also has."""
    sheath = made.truth["sheath"]
    true = {"K": sheath["K"], "L/EA": sheath["L"] / sheath["EA"]}
    if sheath["k"]:
        true["tip compliance"] = 1.0 / sheath["k"]
    minutes = made.time[-1] / 60.0
    for name, secret in made.truth.items():
        if name != "sheath":
            words = {_RENAMED.get((name, key), key): value for key, value in secret.items()}
            if name in _AT_THE_END:
                words["rate"] = words.pop(_AT_THE_END[name]) / minutes
            true |= {f"{name}.{key}": value for key, value in words.items()}
    numbers = found.parameters
    rows = [
        Checked(name, float(true[name]), number.value, number.low, number.high)
        for name, number in numbers.items()
        if isinstance(true.get(name), float | int)
    ]
    return tuple(rows) + tuple(_amplitudes(true, numbers))


def _amplitudes(true, numbers):
    """Yield the amplitudes of waves, which are found as a sine and a cosine."""
    for name in (key.removesuffix(".sine") for key in numbers if key.endswith(".sine")):
        if f"{name}.amplitude" in true:
            sine, cosine = (numbers[f"{name}.{key}"] for key in ANGLES)
            size = math.hypot(sine.value, cosine.value)
            spread = math.hypot(sine.high - sine.low, cosine.high - cosine.low) / 2.0
            wanted = float(true[f"{name}.amplitude"])
            yield Checked(f"{name}.amplitude", wanted, size, size - spread, size + spread)


_AT_THE_END = {
    "friction_drift": "change",
    "proximal_tension_drift": "drift",
    "distal_tension_drift": "drift",
}
"""Effects whose size is told at the record's end, and found as a rate a minute."""

_RENAMED = {
    ("friction_step", "time"): "onset",
    ("encoder_slip", "time"): "onset",
    ("tip_moved", "time"): "onset",
    ("tip_moved", "travel"): "size",
    ("tip_moved", "ramp"): "duration",
    ("sensor_lag", "lag"): "time",
    ("presliding", "bristle"): "distance",
    ("stick_slip", "excess"): "ratio",
}
