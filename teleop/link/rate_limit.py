"""A rate limit, as a token bucket: bursts up to a size, and a rate on average."""

from collections.abc import Callable

from teleop.runtime.clock import now_ns


class RateLimit:
    """Allows `burst` events at once, refilled at `rate_hz` [1/s]; used from one thread.

    Parameters
    ----------
    burst : int
        Events allowed at once.
    rate_hz : float
        Events allowed per second on average.
    clock : callable
        Returns the time [ns].
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
