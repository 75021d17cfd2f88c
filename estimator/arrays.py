"""What numpy does to short arrays, for compiled functions: its own take seconds to compile."""

import math

from estimator.array_types import Array
from estimator.compiled import jit_compile


@jit_compile
def copy_values(values: Array, into: Array) -> None:
    """Write `values`, shape (n,), into the first n entries of another array."""
    for i in range(len(values)):
        into[i] = values[i]


@jit_compile
def compute_median(values: Array) -> float:
    """Return the median of numbers, shape (n,), n > 0; they are left in order, smallest first.

    None of them may be NaN.
    """
    n = len(values)
    for i in range(1, n):
        value, place = values[i], i
        while place > 0 and values[place - 1] > value:
            values[place] = values[place - 1]
            place -= 1
        values[place] = value
    middle = n // 2
    if n % 2 == 1:
        return float(values[middle])
    return float((values[middle - 1] + values[middle]) / 2.0)


@jit_compile
def interpolate(x: float, places: Array, values: Array) -> float:
    """Return the value at `x` on straight lines between points, and beyond them that of the last.

    Parameters
    ----------
    places, values : array, shape (n,)
        The points; `places` never fall.
    """
    if math.isnan(x):
        return x
    n = len(places)
    after, last = 0, n  # the first point beyond `x`, found by halving
    while after < last:
        middle = (after + last) // 2
        if places[middle] <= x:
            after = middle + 1
        else:
            last = middle
    if after == 0:
        return float(values[0])
    if after == n:
        return float(values[n - 1])
    base, value = places[after - 1], values[after - 1]
    return float((values[after] - value) / (places[after] - base) * (x - base) + value)
