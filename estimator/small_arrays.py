"""What numpy does to short arrays, for compiled functions: its own take seconds to compile."""

import math

from estimator.array_types import Array
from estimator.compiled import jit_compile


@jit_compile
def copy_values(values: Array, into: Array) -> None:
    """Write `values`, shape (n,), into the first n entries of another array.

    A slice of a shape that is not known to fit brings the text of its error along, with all that
    makes numbers into text, in each function that calls it: half of what compiling them takes.
    """
    for i in range(len(values)):
        into[i] = values[i]


@jit_compile
def compute_median(values: Array) -> float:
    """Return the median of numbers, shape (n,), n > 0; they are left in order, smallest first.

    None of them may be NaN.
    """
    n = len(values)
    for i in range(1, n):
        value, index = values[i], i
        while index > 0 and values[index - 1] > value:
            values[index] = values[index - 1]
            index -= 1
        values[index] = value
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
    upper, last = 0, n  # the first point beyond `x`, found by halving
    while upper < last:
        middle = (upper + last) // 2
        if places[middle] <= x:
            upper = middle + 1
        else:
            last = middle
    if upper == 0:
        return float(values[0])
    if upper == n:
        return float(values[n - 1])
    base, value = places[upper - 1], values[upper - 1]
    return float((values[upper] - value) / (places[upper] - base) * (x - base) + value)
