"""A rate limit, as a token bucket: bursts up to a size, and a rate on average."""

from collections import OrderedDict
from collections.abc import Callable
from threading import Lock

from teleop.runtime.clock import now_ns


class RateLimit:
    """Allows `burst` events at once, refilled at `rate_hz` [1/s]; used from one thread.

    `clock` returns the time [ns].
    """

    def __init__(self, burst: int, rate_hz: float, clock: Callable[[], int] = now_ns) -> None:
        self._burst, self._rate_hz, self._clock = float(burst), rate_hz, clock
        self._left, self._before_ns = float(burst), clock()

    def __call__(self) -> bool:
        """Return whether one more event is allowed now, and count it."""
        now = self._clock()
        refill = max(0, now - self._before_ns) * 1e-9 * self._rate_hz
        self._left, self._before_ns = min(self._burst, self._left + refill), now
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


# --- what a process has refused, in words: few, however much is refused

REFUSAL_KINDS_MAX = 16  # kept between two readings; of further ones only their number


class RefusalCounter:
    """Lines for people, with how often each was refused; any thread may use it."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._counts: OrderedDict[str, int] = OrderedDict()
        self._further = 0

    def note(self, what: str, times: int = 1) -> None:
        """Note a refusal."""
        with self._lock:
            if what in self._counts:
                self._counts[what] += times
            elif len(self._counts) < REFUSAL_KINDS_MAX:
                self._counts[what] = times
            else:
                self._further += times

    def take(self) -> list[str]:
        """Return the refusals since the last call as lines."""
        if not self._counts:
            return []
        with self._lock:
            counts, self._counts = self._counts, OrderedDict()
            further, self._further = self._further, 0
        lines = [f"refused: {what}" + (f" ({n} times)" if n > 1 else "")
                 for what, n in counts.items()]  # fmt: skip
        return lines + ([f"refused: {further} more"] if further else [])
