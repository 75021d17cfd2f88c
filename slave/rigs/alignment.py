"""Motor positions and tensions that were sampled at different times, as samples of one time."""

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise

from slave.drivers.driver import Counts, Reading

READINGS_KEPT = 64  # readings of each kind
SMOOTHING = 0.1  # of the mean period


class Aligner:
    """Resamples readings of two buses at the times of the slower one.

    Each reading of the slower bus becomes one sample; the values of the faster are interpolated
    linearly between the readings before and after. A sample waits for the reading after, at most
    one period of the faster bus. Nothing is extrapolated.

    Attributes
    ----------
    worst_s : float
        Largest distance [s] of a sample from the nearer of the two readings it was interpolated
        between: the bound of the alignment error in time.
    """

    def __init__(self) -> None:
        self.worst_s = 0.0
        self._motors = _ReadingStream(lambda reading: reading.position)
        self._cells = _ReadingStream(lambda reading: reading.cell)
        self._last_s = -math.inf

    def samples(
        self, motors: Iterable[Reading], cells: Iterable[Reading]
    ) -> Iterator[tuple[float, Counts, Counts]]:
        """Yield the new samples, oldest first: time [s], motor positions, cells in counts.

        Parameters
        ----------
        motors, cells : iterable of Reading
            New readings, oldest first.
        """
        self._motors.extend(motors)
        self._cells.extend(cells)
        by_cells = self._cells.period_s >= self._motors.period_s
        slow, fast = (self._cells, self._motors) if by_cells else (self._motors, self._cells)
        for time_s, value in slow.until(fast.newest_s):
            between = fast.at(time_s) if time_s > self._last_s else None
            if between is None:
                continue
            other, distance_s = between
            self._last_s = time_s
            self.worst_s = max(self.worst_s, distance_s)
            yield (time_s, other, value) if by_cells else (time_s, value, other)
        fast.forget(self._last_s)


class _ReadingStream:
    """Readings of one bus, of which `select` takes the values in use."""

    def __init__(self, select: Callable[[Reading], Counts]) -> None:
        self.newest_s = -math.inf
        self.period_s = math.nan  # mean; comparisons with an unknown one fail
        self._select = select
        self._kept: deque[tuple[float, Counts]] = deque(maxlen=READINGS_KEPT)
        self._waiting: deque[tuple[float, Counts]] = deque(maxlen=READINGS_KEPT)

    def extend(self, readings: Iterable[Reading]) -> None:
        """Add readings; those that are not newer than the last are dropped."""
        for reading in readings:
            elapsed = reading.time_s - self.newest_s
            if elapsed <= 0.0:
                continue
            if math.isfinite(elapsed):
                known = math.isfinite(self.period_s)
                change = elapsed - self.period_s if known else 0.0
                self.period_s = (self.period_s if known else elapsed) + SMOOTHING * change
            self.newest_s = reading.time_s
            entry = (reading.time_s, self._select(reading))
            self._kept.append(entry)
            self._waiting.append(entry)

    def until(self, time_s: float) -> Iterator[tuple[float, Counts]]:
        """Take the waiting readings up to a time."""
        while self._waiting and self._waiting[0][0] <= time_s:
            yield self._waiting.popleft()

    def forget(self, time_s: float) -> None:
        """Drop the waiting readings up to a time."""
        while self._waiting and self._waiting[0][0] <= time_s:
            self._waiting.popleft()

    def at(self, time_s: float) -> tuple[Counts, float] | None:
        """Return the values at a time, and its distance [s] to the nearer reading."""
        for (t0, a), (t1, b) in pairwise(self._kept):
            if t0 <= time_s <= t1:
                share = (time_s - t0) / (t1 - t0)
                return a + share * (b - a), min(time_s - t0, t1 - time_s)
        return None
