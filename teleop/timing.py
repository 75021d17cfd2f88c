"""Durations of a whole run and of its newest span, in memory that does not grow with the run."""

from array import array

_FINE_NS, _FINE = 1_000, 100_000  # bins up to 0.1 s
_COARSE_NS, _COARSE = 100_000, 19_000  # and on to 2 s; what is longer is counted in the last one
_TURN_NS = _FINE_NS * _FINE


class Durations:
    """A histogram with bins of 1 µs (0.1 ms beyond 0.1 s), and the values since the last report.

    Examples
    --------
    >>> durations = Durations()
    >>> for value_ns in (1_000, 2_000, 30_000):
    ...     durations.add(value_ns)
    >>> durations.percentile_ns(50.0)
    2000
    """

    def __init__(self) -> None:
        self.count = 0
        self._bins = array("Q", bytes(8 * (_FINE + _COARSE + 1)))
        self._span: list[int] = []

    def add(self, duration_ns: int) -> None:
        """Count one duration [ns]."""
        self.count += 1
        if duration_ns < _TURN_NS:
            index = max(duration_ns // _FINE_NS, 0)
        else:
            index = _FINE + min((duration_ns - _TURN_NS) // _COARSE_NS, _COARSE)
        self._bins[index] += 1
        self._span.append(duration_ns)

    def percentile_ns(self, percent: float) -> int | None:
        """Return the lower edge [ns] of the bin that holds the percentile; None without values."""
        if not self.count:
            return None
        rank, seen, index = percent / 100.0 * (self.count - 1), 0, -1
        while seen <= rank:
            index += 1
            seen += self._bins[index]
        return min(index, _FINE) * _FINE_NS + max(index - _FINE, 0) * _COARSE_NS

    def take_span(self) -> tuple[int, int]:
        """Return median and 99th percentile [ns] since the last call, and begin a new span."""
        values = sorted(self._span)
        self._span.clear()
        if not values:
            return 0, 0
        return values[len(values) // 2], values[int(0.99 * (len(values) - 1))]
