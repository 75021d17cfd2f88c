"""Velocity from an encoder: first-order adaptive windowing.

A difference over one tick of an encoder of resolution d has errors of d/T; a fixed filter trades
them for lag. Here the window is as long as a straight line through its positions explains all of
them to +-d, at most `longest`: long at rest and in slow or even motion, short where the motion
bends (Janabi-Sharifi, Hayward & Chen, "Discrete-time adaptive windowing for velocity estimation",
IEEE Trans. Control Systems Technology 8, 2000, 1003-1009). The velocity is the slope of the least
squares line in that window (their best-fit variant), the window's own that of its end points.

The resolution is learned from the steps of the position. A device that reports more seldom than
it is read moves in stairs; these count as resolution, and are smoothed alike. Positions without
steps (a simulated hand) have none, and the window is a tick.
"""

from typing import Annotated

from estimator.array_types import Array
from estimator.compiled import compiled
from estimator.records import F64, I64, Field, Record

SAMPLES = 64  # kept; the longest window has one tick less
_SHRINKS = 0.8  # of the learned resolution, for each step that no plateau precedes


class VelocityWindow(Record):
    """The newest positions of one axis, and what is known of its encoder."""

    position: Annotated[Array, Field("f8", SAMPLES)]  # [m] a ring
    elapsed: Annotated[Array, Field("f8", SAMPLES)]  # [s] from each position to the next
    newest: I64 = 0  # its place in the ring
    count: I64 = 0  # how many are known
    least: F64 = 0.0  # [m] smallest step so far, 0 = none
    resolution: F64 = 0.0  # [m] size of a step from a plateau
    plateaus: I64 = 0  # steps in a row that a plateau precedes
    rests: I64 = 0  # ticks without a step


@compiled
def update(window: VelocityWindow, position: float, dt: float, longest: float) -> float:
    """Add a position and return the velocity [m/s]; 0 until two positions are known.

    Parameters
    ----------
    window : VelocityWindow
        Changed in place.
    position : float
        Measured now [m].
    dt : float
        Time since the last position [s].
    longest : float
        Upper bound of the window [s]; with less than two ticks the velocity is a difference.
    """
    if window.count > 0:
        if dt <= 0.0:
            return slope(window, longest)
        _learn(window, abs(position - window.position[window.newest]))
        window.elapsed[window.newest] = dt
    window.newest = (window.newest + 1) % SAMPLES
    window.position[window.newest] = position
    window.count = min(window.count + 1, SAMPLES)
    return slope(window, longest)


@compiled
def forget(window: VelocityWindow) -> None:
    """Forget all positions, but not the encoder."""
    window.count = 0


@compiled
def _learn(window: VelocityWindow, step: float) -> None:
    """Update the resolution with a `step` [m]: that of a stair, else of the smallest step."""
    if step == 0.0:
        window.rests += 1
        return
    window.least = min(window.least, step) if window.least > 0.0 else step
    window.plateaus = window.plateaus + 1 if window.rests > 0 else 0
    if window.plateaus > 1:
        window.resolution = step
    else:
        window.resolution = max(window.least, _SHRINKS * min(window.resolution, step))
    window.rests = 0


@compiled
def slope(window: VelocityWindow, longest: float) -> float:
    """Return the slope [m/s] of the longest window that a line explains.

    A line from the newest position to the n-th before fits if its slope is within those of the
    lines that pass each position between at +-`resolution`; so a window is found in one pass.
    """
    low, high = -1e300, 1e300
    newest = window.position[window.newest]
    at, back = window.newest, 0.0
    found = 0.0
    n, of_t, of_y, of_tt, of_ty = 1.0, 0.0, 0.0, 0.0, 0.0  # sums over the window
    for taken in range(1, window.count):
        at = (at - 1) % SAMPLES
        back += window.elapsed[at]
        if taken > 1 and back > longest:
            break
        fell = newest - window.position[at]
        if not low <= fell / back <= high:
            break
        low = max(low, (fell - window.resolution) / back)
        high = min(high, (fell + window.resolution) / back)
        n += 1.0
        of_t += back
        of_y += fell
        of_tt += back * back
        of_ty += back * fell
        found = (n * of_ty - of_t * of_y) / (n * of_tt - of_t * of_t)
    return found
