"""Durations of a whole run and of its newest span, in memory that does not grow with the run."""

from array import array

_BIN_NS = 1_000
_BINS = 100_000  # 0.1 s; what is longer is counted in the last one


class Durations:
    """A histogram with 1 µs bins, and the values since the last report.

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
        self._bins = array("Q", bytes(8 * (_BINS + 1)))
        self._span: list[int] = []

    def add(self, duration_ns: int) -> None:
        """Count one duration [ns]."""
        self.count += 1
        self._bins[min(max(duration_ns // _BIN_NS, 0), _BINS)] += 1
        self._span.append(duration_ns)

    def percentile_ns(self, percent: float) -> int | None:
        """Return the lower edge [ns] of the bin that holds the percentile; None without values."""
        if not self.count:
            return None
        rank, seen, index = percent / 100.0 * (self.count - 1), 0, -1
        while seen <= rank:
            index += 1
            seen += self._bins[index]
        return index * _BIN_NS

    def take_span(self) -> tuple[int, int]:
        """Return median and 99th percentile [ns] since the last call, and begin a new span."""
        values = sorted(self._span)
        self._span.clear()
        if not values:
            return 0, 0
        return values[len(values) // 2], values[int(0.99 * (len(values) - 1))]
