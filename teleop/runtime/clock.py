"""Clock, absolute time grid, and statistics of durations.

Stamps are nanoseconds since the Unix epoch, anchored once to the system clock and continued with
the monotonic one: comparable across processes, dated, and without jumps.
"""

import gc
import time
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from teleop.errors import TeleopError

STALL_NS = 5_000_000  # [ns] a loop must decide again after this time
STEP_MAX_S = 0.005  # [s] upper bound of a time step of gates and control, also after skipped ticks

_ANCHOR_NS = time.time_ns() - time.monotonic_ns()


def now_ns() -> int:
    """Return the present stamp [ns]: monotonic, counted from the Unix epoch."""
    return _ANCHOR_NS + time.monotonic_ns()


def monotonic_ns(stamp_ns: int) -> int:
    """Return the time of the machine's monotonic clock [ns] at which `now_ns` gives this stamp."""
    return stamp_ns - _ANCHOR_NS


# --- suspension of the machine, in which the monotonic clock of Linux stands still

SUSPENSION_MIN_NS = 100_000_000  # [ns]


def read_suspended_ns() -> int:
    """Return for how long the machine was suspended since it was switched on [ns].

    Too little by as long as the process is held up between the two clocks.
    """
    if not hasattr(time, "CLOCK_BOOTTIME"):
        return 0
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME) - time.monotonic_ns()


class SuspensionWatch:
    """Tells of suspensions: hands, motors and devices are elsewhere afterwards."""

    def __init__(self) -> None:
        self._known_ns = max(read_suspended_ns() for _ in range(3))

    def explain(self) -> str:
        """Return what happened since the last call, with the remedy; empty if nothing did."""
        suspended_ns = read_suspended_ns() - self._known_ns
        if suspended_ns < SUSPENSION_MIN_NS:
            return ""
        self._known_ns += suspended_ns
        return (
            f"the machine was suspended for {suspended_ns * 1e-9:.1f} s: start or engage again; "
            "`systemd-inhibit teleop run ...` prevents it"
        )


@dataclass(slots=True)  # made every tick: frozen, that would take seven times as long
class Tick:
    """One point of the grid: its index, its time and the time since the last one that ran."""

    index: int
    stamp_ns: int  # actual start of the tick, by `now_ns`
    dt: float  # [s] since the previous tick; on a grid a whole number of periods
    answers: bool = False  # whether a message arrived that needs an answer


@dataclass(slots=True)
class TickStats:
    """Counts of one loop, read while it runs (status line) and after it (summary)."""

    ticks: int = 0
    overruns: int = 0  # periods skipped because a tick outlasted its own
    lateness_max_ns: int = 0
    first_ns: int = 0
    last_ns: int = 0

    @property
    def rate_hz(self) -> float:
        """Achieved rate [Hz] between the first and the last tick."""
        span = self.last_ns - self.first_ns
        return (self.ticks - 1) * 1e9 / span if span > 0 else 0.0


class Grid:
    """An absolute time grid: ticks fall on `(k + phase) * period` of the machine's monotonic clock.

    All processes of a machine share that clock, whatever happens to the system clock. So two loops
    of one machine have a known phase: with the slave half a period behind the master, each has the
    other's newest message well before its own tick, and a command returns as a force after exactly
    one period. Unaligned grids took one or two, at random, for a whole run.

    A tick whose work outlasts its period makes the grid skip whole periods and count them; it never
    catches up with a burst, as a burst of forces is wrong.

    Parameters
    ----------
    rate_hz : float
        Grid rate [Hz].
    phase : float
        Phase of the ticks in the period, 0 to 1.
    stop : callable
        Called before each tick; true ends the iteration.
    now, sleep : callable
        Injected by tests; the machine's monotonic clock [ns] otherwise.
    """

    def __init__(
        self,
        rate_hz: float,
        stop: Callable[[], bool],
        phase: float = 0.0,
        now: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.period_ns = round(1e9 / rate_hz)
        self.stats = TickStats()
        self._offset_ns = round(phase * self.period_ns)
        self._stop, self._now, self._sleep = stop, now, sleep

    def __iter__(self) -> Iterator[Tick]:
        """Yield ticks until `stop` returns true."""
        stats, period = self.stats, self.period_ns
        now = self._now()
        target = now + (self._offset_ns - now) % period  # the next point of the grid
        index, skipped = 0, 0
        while not self._stop():
            wait = target - self._now()
            if wait > 0:
                self._sleep(wait * 1e-9)
            begin = self._now()
            stats.ticks += 1
            stats.first_ns = stats.first_ns or begin
            stats.last_ns = begin
            stats.lateness_max_ns = max(stats.lateness_max_ns, begin - target)
            yield Tick(index, _ANCHOR_NS + begin, (1 + skipped) * period * 1e-9)
            skipped = max(0, (self._now() - target) // period)
            stats.overruns += skipped
            target += (1 + skipped) * period
            index += 1 + skipped


class EventClock:
    """Ticks at arrivals, or else at a deadline.

    While arrivals come at about `rate_hz`, each is a tick at once, despite jitter: the deadline is
    `LATE` periods after the last tick. After a missed deadline the next ones are a period apart, so
    a loop without arrivals runs at its own rate. Ticks are at least `NEAREST` periods apart: a
    burst is one tick with the newest value.

    Parameters
    ----------
    rate_hz : float
        Rate without arrivals, and approximate rate of arrivals [Hz].
    stop : callable
        Called before each tick; true ends the iteration.
    wait : callable
        Waits for an arrival until a time of the machine's monotonic clock [ns]; returns whether
        there was one.
    now, sleep : callable
        Injected by tests; the machine's monotonic clock [ns] otherwise.

    Raises
    ------
    TeleopError
        At a tick after the machine was suspended.
    """

    LATE = 1.5
    NEAREST = 0.5

    def __init__(
        self,
        rate_hz: float,
        stop: Callable[[], bool],
        wait: Callable[[int], bool],
        now: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.period_ns = round(1e9 / rate_hz)
        self.stats = TickStats()
        self._stop, self._wait, self._now, self._sleep = stop, wait, now, sleep
        self._suspension = SuspensionWatch()

    def __iter__(self) -> Iterator[Tick]:
        """Yield ticks until `stop` returns true."""
        stats, period = self.stats, self.period_ns
        late_ns, nearest_ns = round(self.LATE * period), round(self.NEAREST * period)
        last, deadline = self._now() - period, self._now()
        index = 0
        while not self._stop():
            arrived = self._wait(deadline)
            early = last + nearest_ns - self._now()
            if early > 0:
                self._sleep(early * 1e-9)
            if explanation := self._suspension.explain():
                raise TeleopError(explanation)
            begin = self._now()
            stats.ticks += 1
            stats.first_ns = stats.first_ns or begin
            stats.last_ns = begin
            stats.lateness_max_ns = max(stats.lateness_max_ns, begin - deadline)
            stats.overruns += max(0, (begin - last) // period - 1) if index else 0
            yield Tick(index, _ANCHOR_NS + begin, (begin - last) * 1e-9, arrived)
            last = begin
            deadline = begin + late_ns if arrived else self._compute_next(deadline)
            index += 1

    def _compute_next(self, deadline: int) -> int:
        """Return the next deadline [ns] of a loop without arrivals, on a grid."""
        skipped = max(0, (self._now() - deadline) // self.period_ns)
        return deadline + (1 + skipped) * self.period_ns


class pause_garbage_collection:  # noqa: N801 - used as a statement: `with quiet_garbage():`
    """Disable garbage collection in a loop and freeze existing objects; those frozen remain so."""

    def __enter__(self) -> None:
        self._was_frozen = gc.get_freeze_count() > 0
        gc.collect()
        gc.freeze()
        gc.disable()

    def __exit__(self, *_: object) -> None:
        gc.enable()
        if not self._was_frozen:
            gc.unfreeze()


# --- duration statistics of a whole run and since the last report, in constant memory

_FINE_NS, _FINE = 1_000, 100_000  # bins up to 0.1 s
_COARSE_NS, _COARSE = 100_000, 19_000  # up to 2 s; longer ones in the last bin
_TURN_NS = _FINE_NS * _FINE
_SPAN_MAX = 10_000  # values; a longer span, for which nobody asks, is cut


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
    >>> durations.compute_percentile_ns(50.0)
    2000
    """

    def __init__(self) -> None:
        self._largest = 0
        self._bins = np.zeros(_FINE + _COARSE + 1, np.int64)
        self._span = array("q")

    def add(self, duration_ns: int) -> None:
        """Add one duration [ns]; a loop does so several times a tick, so it is binned later."""
        self._span.append(duration_ns)
        if len(self._span) == _SPAN_MAX:
            self.take_span()

    def compute_percentile_ns(self, percent: float) -> int | None:
        """Return the lower edge [ns] of the bin that holds the percentile; None without values.

        Starts a new span.
        """
        self.take_span()
        numbers = np.cumsum(self._bins)
        if not numbers[-1]:
            return None
        index = int(np.searchsorted(numbers, percent / 100.0 * (numbers[-1] - 1), side="right"))
        return min(index, _FINE) * _FINE_NS + max(index - _FINE, 0) * _COARSE_NS

    def compute_percentiles(self, unit: float) -> Percentiles:
        """Return the count, p50, p99, p99.9 and largest; `unit` converts from nanoseconds.

        Starts a new span.
        """
        values = [self.compute_percentile_ns(percent) for percent in (50.0, 99.0, 99.9)]
        p50, p99, p99_9 = (None if value is None else value * unit for value in values)
        count = int(self._bins.sum())
        return Percentiles(count, p50, p99, p99_9, self._largest * unit if count else None)

    def take_span(self) -> Span:
        """Return the durations since the last call, and start a new span."""
        if not self._span:
            return Span()
        values, self._span = np.frombuffer(self._span, np.int64), array("q")
        values.sort()
        bins = values // _FINE_NS
        if not 0 <= values[0] <= values[-1] < _TURN_NS:
            bins = np.clip(bins, 0, _FINE)
            bins += np.clip((values - _TURN_NS) // _COARSE_NS, 0, _COARSE)
        np.add.at(self._bins, bins, 1)
        last = len(values) - 1
        p50, p99, p99_9 = (int(values[int(rank * last + 0.5)]) for rank in (0.5, 0.99, 0.999))
        self._largest = max(self._largest, int(values[-1]))
        return Span(len(values), p50, p99, p99_9, int(values[-1]))
