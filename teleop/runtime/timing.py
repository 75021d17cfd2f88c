"""Duration statistics of a whole run and since the last report, in constant memory."""

from array import array
from dataclasses import dataclass
from typing import NamedTuple

_FINE_NS, _FINE = 1_000, 100_000  # bins up to 0.1 s
_COARSE_NS, _COARSE = 100_000, 19_000  # up to 2 s; longer ones in the last bin
_TURN_NS = _FINE_NS * _FINE


class Span(NamedTuple):
    """Durations [ns] since the last report."""

    values: int = 0
    p50: int = 0
    p99: int = 0
    p99_9: int = 0
    largest: int = 0


@dataclass(frozen=True, slots=True)
class Percentiles:
    """Durations of a whole run, in a unit of its field's name; None without values."""

    n: int = 0
    p50: float | None = None
    p99: float | None = None
    p99_9: float | None = None
    max: float | None = None


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
        self._largest = 0
        self._bins = array("Q", bytes(8 * (_FINE + _COARSE + 1)))
        self._span: list[int] = []

    def add(self, duration_ns: int) -> None:
        """Add one duration [ns]."""
        self.count += 1
        self._largest = max(self._largest, duration_ns)
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

    def percentiles(self, unit: float) -> Percentiles:
        """Return the count, p50, p99, p99.9 and largest; `unit` converts from nanoseconds."""
        values = [self.percentile_ns(percent) for percent in (50.0, 99.0, 99.9)]
        p50, p99, p99_9 = (None if value is None else value * unit for value in values)
        largest = self._largest * unit if self.count else None
        return Percentiles(self.count, p50, p99, p99_9, largest)

    def take_span(self) -> Span:
        """Return the durations since the last call, and start a new span."""
        values = sorted(self._span)
        self._span.clear()
        if not values:
            return Span()
        last = len(values) - 1
        p50, p99, p99_9 = (values[int(rank * last + 0.5)] for rank in (0.5, 0.99, 0.999))
        return Span(len(values), p50, p99, p99_9, values[-1])
