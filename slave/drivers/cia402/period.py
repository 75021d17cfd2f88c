"""The interpolation period of a drive (object 60C2): a count of units of a power of ten."""

import math

RATE_MIN, RATE_MAX = 10.0, 2000.0  # [Hz] of SYNC
COUNT_MAX = 255  # of 60C2:1, unsigned 8 bits
EXPONENTS = (-3, -4, -5)  # of 60C2:2, in order of preference: drives know milliseconds best
TOLERANCE = 1e-5  # of a rate that is written with six digits


def encode_period(rate_hz: float) -> tuple[int, int]:
    """Return the period of a rate [Hz] as a count, and the exponent of ten of its unit [s].

    Raises
    ------
    ValueError
        The period is no whole number of any unit; the nearest rate with such a period is named.
    """
    for exponent in EXPONENTS:
        period = 10.0**-exponent / rate_hz
        count = round(period)
        if 1 <= count <= COUNT_MAX and math.isclose(period, count, rel_tol=TOLERANCE):
            return count, exponent
    raise ValueError(
        f"rate_hz: its period must be 1 to {COUNT_MAX} whole units of 1, 0.1 or 0.01 ms (object "
        f"60C2); the nearest is {nearest_rate(rate_hz):.6g} Hz"
    )


def nearest_rate(rate_hz: float) -> float:
    """Return the rate [Hz] nearest to `rate_hz` whose period can be encoded."""
    return min(_usable_rates(), key=lambda usable: abs(usable - rate_hz))


def highest_rate(limit_hz: float) -> float:
    """Return the highest rate [Hz] up to `limit_hz` whose period can be encoded, or the lowest."""
    return max((usable for usable in _usable_rates() if usable <= limit_hz), default=RATE_MIN)


def _usable_rates() -> list[float]:
    rates = (10.0**-e / count for e in EXPONENTS for count in range(1, COUNT_MAX + 1))
    return [rate for rate in rates if RATE_MIN <= rate <= RATE_MAX]
