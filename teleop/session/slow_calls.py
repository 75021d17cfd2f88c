"""Calls of a rig or a device that hold up a loop, noticed while it runs."""

SLOW_CALL_NS = 2_000_000  # [ns] of a call; "well within a millisecond" is the contract
CALLS_MIN = 5  # calls between two reports


class SlowCallMonitor:
    """Notices a method that mostly takes too long; one call that the machine held up is none.

    The message has the `name` of the method.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._calls = self._slow = self._longest_ns = 0
        self._is_reported = False

    def add(self, elapsed_ns: int) -> None:
        """Add the time of one call [ns]."""
        self._calls += 1
        if elapsed_ns > SLOW_CALL_NS:
            self._slow += 1
            self._longest_ns = max(self._longest_ns, elapsed_ns)

    def take(self) -> str:
        """Return the warning, once, if most calls since the last report were slow; else nothing."""
        calls, slow, longest_ns = self._calls, self._slow, self._longest_ns
        self._calls = self._slow = self._longest_ns = 0
        if self._is_reported or calls < CALLS_MIN or 2 * slow <= calls:
            return ""
        self._is_reported = True
        return (
            f"{self._name} takes up to {longest_ns / 1e6:.0f} ms, {SLOW_CALL_NS / 1e6:g} ms at "
            "most: it holds up the loop; let a thread wait for the hardware, and take its newest "
            "value"
        )
